// Distances that must not fall below 0, whatever they are distances of.
#pragma once

#include <cstdint>

#include "base/memory.hpp"
#include "base/numbers.hpp"
#include "kinematics/mujoco.hpp"

namespace rmrc {

/// The entries of a barrier that may bind in a step: rmrc.limits.barrier.Near.
struct Near {
  std::int64_t* ids;  // in ascending order
  double* distance;   // h above the limit
  double* slope;      // ∂h/∂q (count, nv)
  double* drift;      // ∂h/∂t of what moves by itself
  int count;
};

/// A source of distances h(q): rmrc.limits.barrier.Barrier.
class Barrier {
 public:
  /// `size` entries; `gain` and `push` as there.
  Barrier(int size, double gain, double push) : size_(size), gain_(gain), push_(push) {}
  virtual ~Barrier() = default;
  Barrier(const Barrier&) = delete;
  Barrier& operator=(const Barrier&) = delete;

  /// Add the poses that `distance` reads, and what goes with it, where a command leads (`ahead`), or
  /// all that `near` and `kept` read.
  virtual void read(const Kinematics& at, bool ahead, Poses& poses) const = 0;

  /// Write what may bind in a step of dt in which each dof moves by no more than `travel` (nv,).
  virtual void near(const Kinematics& now, const double* travel, double dt, Near& near) = 0;

  /// Write further functions that bound h of what is near from above, after `near` at the same
  /// kinematics.
  virtual void kept(const Kinematics&, Near& near) { near.count = 0; }

  /// Return how many there can be.
  virtual int most_kept() const { return 0; }

  /// Forget what such functions are of.
  virtual void forget() {}

  /// Return h of an entry at other kinematics.
  virtual double distance(const Kinematics& at, int id) const = 0;

  /// Return the most by which h of an entry can fall in a step |Δq| (nv,) of dt.
  virtual double reach(int id, const double* step, double dt) const = 0;

  /// Return how far an entry may move between two looks, not to pass unnoticed.
  virtual double thickness(int) const { return infinity; }

  /// Go through what there is to keep between two steps.
  virtual void keep(Memory&) {}

  int size() const { return size_; }
  double gain() const { return gain_; }
  double push() const { return push_; }

 private:
  int size_;
  double gain_, push_;
};

}  // namespace rmrc
