// Many controllers of one problem at once: rmrc.control.batch.
#pragma once

#include <cstddef>
#include <cstdint>
#include <mutex>
#include <vector>

#include "base/thread_pool.hpp"
#include "control/inputs.hpp"
#include "control/stepper.hpp"

namespace rmrc {

/// What steps of one thread are taken by, and where it reads the targets.
struct Worker {
  Stepper* stepper;
  double* targets;
  double* twists;
  std::uint8_t* moving;
};

/// Return how many bytes a stepper keeps of an element.
std::size_t kept_bytes(Stepper& stepper);

/// A target among those of a problem: of which task, and where it begins.
struct TargetPlace {
  int task, first;
  bool pose;  // or a point
};

/// What a step of all elements writes, by rows.
struct BatchOutput {
  double* v;            // (n, nv)
  double* q;            // (n, nq)
  std::int32_t* flags;  // (n,): bit k for the status of value k
};

/// n controllers that take turns on a few steppers, one a thread.
///
/// Of an element only what it keeps between steps is stored, and is loaded into a stepper before
/// its own: which thread takes a step, and in what order, makes no difference to the numbers. All
/// memory is taken by the constructor. Calls from several threads wait for each other.
class Batch {
 public:
  /// `start` are the targets that elements begin with (size,), of so many tasks.
  Batch(int count, std::vector<Worker> workers, std::vector<double> start, int tasks);
  ~Batch();

  /// Start all elements anew at valid q (n, nq) with v (n, nv), their targets at the start's.
  void reset(const double* q, const double* v);

  /// Set a target of all elements to `values`, by rows xyz + wxyz or xyz, with `velocities` or null.
  ///
  /// Write for each element whether it was valid; where it was not the target stays as it was, and
  /// the element's next step says so.
  void aim(const TargetPlace& place, const double* values, const double* velocities,
           std::uint8_t* accepted);

  /// Take a step of dt seconds from q (n, nq), or from where the last ones led to if q is null.
  ///
  /// An element whose q is not valid brakes.
  void step(const double* q, double dt, const BatchOutput& out);

  /// Write where the last steps have led to (n, nq).
  void read(double* q);

  int count() const { return count_; }
  const MuJoCo& mujoco() const { return workers_[0].stepper->engine().mujoco(); }
  int target_size() const { return static_cast<int>(start_.size()); }
  int tasks() const { return tasks_; }

 private:
  // What a step was called with.
  struct Call {
    const double* q;
    double dt;
    BatchOutput out;
  };

  void take(const Worker& worker, int element, const Call& call);
  void load(const Worker& worker, int element, Memory stored);
  void store(const Worker& worker, int element);
  std::byte* memory(int element) { return memory_.data() + element * bytes_; }

  int count_;
  std::vector<Worker> workers_;
  std::vector<double> start_;
  int tasks_;
  std::size_t bytes_;                           // that an element keeps
  std::vector<std::byte> memory_;               // (n, bytes)
  std::vector<double> targets_, twists_;        // (n, size), (n, tasks, 6)
  std::vector<std::uint8_t> moving_, refused_;  // (n, tasks), (n,)
  std::mutex mutex_;
  ThreadPool pool_;
};

}  // namespace rmrc
