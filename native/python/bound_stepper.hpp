// What takes a controller's common steps, with the arrays of Python's that it points into.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <memory>
#include <tuple>
#include <vector>

#include "control/inputs.hpp"
#include "control/stepper.hpp"

namespace rmrc {

/// A controller's steps where nothing rare happens, and the targets that it may set.
class BoundStepper {
 public:
  using Reading =
      nanobind::ndarray<const double, nanobind::c_contig, nanobind::device::cpu>;
  using Writing = nanobind::ndarray<double, nanobind::c_contig, nanobind::device::cpu>;
  using Flags = nanobind::ndarray<std::uint8_t, nanobind::ndim<1>, nanobind::c_contig,
                                  nanobind::device::cpu>;
  using WatchedTasks = std::vector<std::tuple<int, std::vector<double>, double, double>>;

  /// `owner` is the Python engine of `engine`, which stays as it is where a step is taken here.
  BoundStepper(nanobind::object engine, nanobind::object owner, Writing q, Writing v,
               Writing v_previous, double dt, std::vector<int> quaternions,
               const std::vector<bool>& frozen, double budget, const std::vector<Reading>& kept,
               Flags moving, const WatchedTasks& watched, double tolerance);

  /// Have a target set by this name.
  void add_target(nanobind::str name, bool pose, Writing target, Writing twist,
                  Writing feedforward, Flags moving);

  /// Return the width of a target's velocity, 6 or 3 that of a pose or a point; 0 if `name` is none.
  int width_of(nanobind::handle name) const;

  /// Set a target that is there; false, and nothing is set, if it is not valid.
  bool aim(nanobind::handle name, const Given& given);

  /// Tell the owner, where there are rows, that a step was taken without it.
  void tell() const;

  Stepper& stepper() { return *stepper_; }
  Progress& progress() { return stepper_->progress(); }
  nanobind::handle owner() const { return owner_; }
  double dt() const { return dt_; }

 private:
  // A target with the feed-forward that moves it.
  struct FedAim {
    Aim aim;
    double* feedforward;
    int rows;
  };

  const FedAim* find(nanobind::handle name) const;

  nanobind::object engine_, owner_;
  std::vector<nanobind::object> kept_;
  double dt_;
  std::vector<FedAim> aims_;
  nanobind::dict places_;  // in `aims_` by name
  std::unique_ptr<Stepper> stepper_;
};

}  // namespace rmrc
