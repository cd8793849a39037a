// Many controllers of one problem in Python.

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cstdint>
#include <iterator>
#include <memory>
#include <optional>
#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

#include "control/batch.hpp"
#include "python/bindings.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace rmrc {

namespace {

using Statuses = nb::ndarray<std::int32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

template <class Array>
void require(const Array& array, int rows, int columns) {
  const auto size = static_cast<std::size_t>(rows) * static_cast<std::size_t>(columns);
  rmrc::require(array, size, "an array");
}

class BoundBatch {
 public:
  BoundBatch(int count, const std::vector<std::tuple<nb::object, Writing, Writing, Flags>>& workers,
             std::vector<double> start) {
    if (count < 1 || workers.empty()) throw std::invalid_argument("there is nothing to do");
    Stepper& first = stepper_of(std::get<0>(workers[0]));
    std::vector<Worker> made;
    const auto tasks = static_cast<int>(std::get<3>(workers[0]).size());
    const MuJoCo& is = first.mujoco();
    const auto widest = std::max<std::int64_t>({is.nq, is.nv, std::ssize(start), 6 * tasks, 7});
    require_countable(count, widest);
    for (const auto& [stepper, targets, twists, moving] : workers) {
      Stepper& other = stepper_of(stepper);
      const bool twice = std::any_of(made.begin(), made.end(), [&](const Worker& worker) {
        return worker.stepper == &other;
      });
      if (twice || other.mujoco().nq != is.nq || other.mujoco().nv != is.nv ||
          kept_bytes(other) != kept_bytes(first)) {
        throw std::invalid_argument("the workers are not of one problem, each with its own stepper");
      }
      require(targets, 1, static_cast<int>(start.size()));
      require(twists, tasks, 6);
      require(moving, tasks, 1);
      made.push_back({&stepper_of(stepper), targets.data(), twists.data(), moving.data()});
      for (nb::object part : {stepper, nb::cast(targets), nb::cast(twists), nb::cast(moving)}) {
        kept_.push_back(std::move(part));
      }
    }
    batch_ = std::make_unique<Batch>(count, std::move(made), std::move(start), tasks);
  }

  void reset(const Reading& q, const Reading& v) {
    require(q, batch_->count(), batch_->mujoco().nq);
    require(v, batch_->count(), batch_->mujoco().nv);
    batch_->reset(q.data(), v.data());
  }

  void aim(int task, int first, bool pose, const Reading& values,
           const std::optional<Reading>& velocities, Flags accepted) {
    const int size = pose ? 7 : 3;
    require_index(task, batch_->tasks(), "task");
    require_part(first, size, batch_->target_size(), "target");
    require(values, batch_->count(), size);
    if (velocities) require(*velocities, batch_->count(), pose ? 6 : 3);
    require(accepted, batch_->count(), 1);
    batch_->aim({task, first, pose}, values.data(), velocities ? velocities->data() : nullptr,
                accepted.data());
  }

  void step(const std::optional<Reading>& q, double dt, Writing v, Writing following,
           Statuses flags) {
    if (q) require(*q, batch_->count(), batch_->mujoco().nq);
    require(v, batch_->count(), batch_->mujoco().nv);
    require(following, batch_->count(), batch_->mujoco().nq);
    require(flags, batch_->count(), 1);
    const nb::gil_scoped_release released;
    batch_->step(q ? q->data() : nullptr, dt, {v.data(), following.data(), flags.data()});
  }

  void read(Writing q) {
    require(q, batch_->count(), batch_->mujoco().nq);
    batch_->read(q.data());
  }

 private:
  std::vector<nb::object> kept_;
  std::unique_ptr<Batch> batch_;
};

}  // namespace

void bind_batch(nb::module_& m) {
  nb::class_<BoundBatch>(m, "Batch", "Many controllers that take turns on a few steppers.")
      .def(nb::init<int, const std::vector<std::tuple<nb::object, Writing, Writing, Flags>>&,
                    std::vector<double>>(),
           nb::kw_only(), "count"_a, "workers"_a.noconvert(), "start"_a,
           "Allocate for `count` controllers, and start a thread for each worker but one.\n\n"
           "A worker is a stepper with the targets, twists and moving flags of its engine.")
      .def("reset", &BoundBatch::reset, "q"_a, "v"_a, "Start all anew, their targets as well.")
      .def("aim", &BoundBatch::aim, "task"_a, "first"_a, "pose"_a, "values"_a,
           "velocities"_a.none(), "accepted"_a.noconvert(),
           "Set a target of all, and write for each whether it was valid.")
      .def("step", &BoundBatch::step, "q"_a.none(), "dt"_a, "v"_a.noconvert(),
           "following"_a.noconvert(), "flags"_a.noconvert(),
           "Take a step of all on the threads, without the GIL.")
      .def("read", &BoundBatch::read, "q"_a.noconvert(), "Write where the last steps have led to.");
}

}  // namespace rmrc
