// A controller's common steps in Python: built from the arrays of its engine and its own.

#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <stdexcept>
#include <utility>

#include "python/bindings.hpp"
#include "python/bound_stepper.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace rmrc {

BoundStepper::BoundStepper(nb::object engine, nb::object owner, Writing q, Writing v,
                           Writing v_previous, double dt, std::vector<int> quaternions,
                           const std::vector<bool>& frozen, double budget,
                           const std::vector<Reading>& kept, Flags moving,
                           const WatchedTasks& watched, double tolerance)
    : engine_(std::move(engine)),
      owner_(std::move(owner)),
      kept_{nb::cast(q), nb::cast(v), nb::cast(v_previous), nb::cast(moving)},
      dt_(dt) {
  Engine& native = engine_of(engine_);
  const auto nq = static_cast<std::size_t>(native.mujoco().nq);
  const auto nv = static_cast<std::size_t>(native.mujoco().nv);
  if (q.size() != nq || v.size() != nv || v_previous.size() != nv ||
      frozen.size() != static_cast<std::size_t>(native.size())) {
    throw std::invalid_argument("the state of the controller has a wrong size");
  }
  for (const int first : quaternions) {
    require_part(first, 4, static_cast<std::int64_t>(nq), "quaternion");
  }
  std::vector<KeptArray> arrays;
  for (const Reading& array : kept) {
    arrays.push_back({array.data(), static_cast<int>(array.size())});
    kept_.push_back(nb::cast(array));
  }
  std::vector<Watched> tasks;
  for (const auto& [term, weight, distance, angle] : watched) {
    const auto& terms = native.row_terms();
    if (term < 0 || term >= static_cast<int>(terms.size()) ||
        weight.size() != static_cast<std::size_t>(terms[term]->data().rows)) {
      throw std::invalid_argument("a watched task is none of the engine's");
    }
    tasks.push_back({term, weight, {distance, angle}});
  }
  stepper_ = std::make_unique<Stepper>(
      native,
      Progress(std::move(tasks), tolerance),
      ControllerState{q.data(), v.data(), v_previous.data()}, std::move(quaternions),
      std::vector<char>(frozen.begin(), frozen.end()), budget, std::move(arrays),
      KeptFlags{moving.data(), static_cast<int>(moving.size())});
}

void BoundStepper::add_target(nb::str name, bool pose, Writing target, Writing twist,
                              Writing feedforward, Flags moving) {
  if (target.size() != (pose ? 7u : 3u) || twist.size() != 6 || moving.size() != 1) {
    throw std::invalid_argument("a target has a wrong size");
  }
  for (nb::object array :
       {nb::cast(target), nb::cast(twist), nb::cast(feedforward), nb::cast(moving)}) {
    kept_.push_back(std::move(array));
  }
  places_[name] = static_cast<int>(aims_.size());
  aims_.push_back({{pose, target.data(), twist.data(), moving.data()},
                   feedforward.data(),
                   static_cast<int>(feedforward.size())});
}

const BoundStepper::FedAim* BoundStepper::find(nb::handle name) const {
  if (!PyUnicode_CheckExact(name.ptr())) return nullptr;
  PyObject* place = PyDict_GetItemWithError(places_.ptr(), name.ptr());
  return place == nullptr ? nullptr : &aims_[PyLong_AsSize_t(place)];
}

int BoundStepper::width_of(nb::handle name) const {
  const FedAim* found = find(name);
  return found == nullptr ? 0 : found->aim.width();
}

bool BoundStepper::aim(nb::handle name, const Given& given) {
  const auto& [aim, feedforward, rows] = *find(name);
  const bool moved = *aim.moving != 0;
  if (!aim.take(given)) return false;
  if (moved && given.velocity == nullptr) std::fill_n(feedforward, rows, 0.0);
  return true;
}

void BoundStepper::tell() const {
  const Engine& native = stepper_->engine();
  if (native.cascaded()) nb::setattr(owner_, "scaled", nb::bool_(native.scaled()));
  if (native.limits() == nullptr && native.equalities() == nullptr) return;
  nb::setattr(owner_, "share", nb::float_(native.share()));
  nb::setattr(owner_, "relaxed", nb::bool_(native.relaxed()));
  nb::setattr(owner_, "outside", nb::bool_(native.outside()));
  nb::setattr(owner_, "behind", nb::bool_(true));
}

Stepper& stepper_of(nb::handle object) { return nb::cast<BoundStepper&>(object).stepper(); }

void bind_stepper(nb::module_& m) {
  nb::class_<BoundStepper>(m, "Stepper", "A controller's steps where nothing rare happens.")
      .def(nb::init<nb::object, nb::object, BoundStepper::Writing, BoundStepper::Writing,
                    BoundStepper::Writing, double, std::vector<int>, const std::vector<bool>&,
                    double, const std::vector<BoundStepper::Reading>&, BoundStepper::Flags,
                    const BoundStepper::WatchedTasks&, double>(),
           nb::kw_only(), "engine"_a, "owner"_a, "q"_a.noconvert(), "v"_a.noconvert(),
           "v_previous"_a.noconvert(), "dt"_a, "quaternions"_a, "frozen"_a, "budget"_a,
           "kept"_a.noconvert(), "moving"_a.noconvert(), "watched"_a,
           "tolerance"_a)
      .def("add_target", &BoundStepper::add_target, "name"_a, "pose"_a, "target"_a.noconvert(),
           "twist"_a.noconvert(), "feedforward"_a.noconvert(), "moving"_a.noconvert(), "Have a target set by this name.")
      .def("reset", [](BoundStepper& bound) { bound.progress().reset(); },
           "Forget the progress that was made.")
      .def(
          "update",
          [](BoundStepper& bound, const BoundStepper::Reading& v, double dt) {
            const Engine& engine = bound.stepper().engine();
            if (v.size() != static_cast<std::size_t>(engine.size())) {
              throw std::invalid_argument("v has a wrong size");
            }
            bound.progress().update(engine, v.data(), dt);
          },
          "v"_a, "dt"_a, "Take note of a command v (n,) at the last evaluation, for a step of dt.")
      .def_prop_ro("stuck", [](BoundStepper& bound) { return bound.progress().stuck(); },
                   "Whether the tasks are stuck.");
}

}  // namespace rmrc
