// The engine in Python: built from the arrays of an `Evaluation` and an `Assembly`, which it fills.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <tuple>
#include <vector>

#include "engine/engine.hpp"
#include "python/bindings.hpp"
#include "tasks/loop.hpp"

namespace rmrc {

/// What all terms have, with the arrays of Python's that they point into.
struct RowsArgument {
  TermData data;
  Numbers root;
  Reading target, twist;
  Flags moving;
  std::vector<WayJoint> way;
  Numbers exact_root;
};

/// A frame, with its arrays.
struct FrameArgument {
  Frame frame;
  Reading position, rotation, reference;
  std::optional<Reading> carrier;
};

using AnchorageArgument = std::tuple<FrameArgument, Reading, Numbers, Numbers>;
using PairArgument = std::tuple<int, bool, double, AnchorageArgument, AnchorageArgument>;
using SumArgument = std::tuple<std::vector<std::tuple<int, int, double>>, double>;
using PolynomialArgument = std::tuple<int, SumArgument, SumArgument, Numbers>;

/// The engine, and the arrays of Python's that it points into.
class BoundEngine {
 public:
  BoundEngine(const std::vector<std::uintptr_t>& functions, nanobind::object model, nanobind::object data,
              Writing qpos, Reading cdof, Writing error, Writing feedforward,
              Writing rate, Writing jacobian, Reading v_previous, Reading a_previous,
              std::vector<int> dofs, Numbers hessian, double unit, double share_of_inertia,
              double floor, double least_curvature,
              bool brakes, double soft_ratio,
              const std::tuple<std::vector<int>, Numbers, Numbers, double, Numbers, Numbers,
                               Numbers, Numbers>& limits,
              Writing H, Writing g, Writing added_damping, Writing inertia, Writing lb, Writing ub,
              int max_iter);

  void limit(nanobind::object rows, nanobind::object shortening);
  void follow(nanobind::object kinematics);

  const std::vector<nanobind::object>& kept() const { return kept_; }
  Engine& operator*() { return *engine_; }
  const Engine& operator*() const { return *engine_; }

  void add_frame(const RowsArgument& rows, const FrameArgument& frame);
  void add_world_frame(const RowsArgument& rows, const FrameArgument& frame);
  void add_relative(const RowsArgument& rows, const FrameArgument& frame,
                    const FrameArgument& root);
  void add_axis(const RowsArgument& rows, const FrameArgument& frame, const Numbers& axis,
                bool at_point);
  void add_com(const RowsArgument& rows,
               const std::vector<std::tuple<int, double, Reading, Reading>>& moved,
               const std::vector<std::tuple<double, Reading, Reading, std::optional<Reading>>>&
                   parts);
  void add_coupling(const RowsArgument& rows, const Numbers& by_coordinate, const Numbers& by_dof,
                    double offset);
  void add_loop(const RowsArgument& rows, const std::vector<PairArgument>& pairs,
                const std::vector<PolynomialArgument>& polynomials, const Numbers& scale,
                const std::vector<bool>& angular);
  void add_foreign(const RowsArgument& rows);
  void add_joint_task(const RowsArgument& rows, const std::string& kind,
                      const std::vector<int>& wrapped);
  void adapt(const std::string& rule, double threshold, double largest, int rank, double scale,
             const std::vector<std::tuple<int, int>>& rows);

 private:
  // Add a term with so many rows, whose target has at least so many numbers.
  template <class Term, class... Arguments>
  void add(const RowsArgument& rows, int count, std::size_t target, Arguments&&... arguments);

  static void require_target(const RowsArgument& rows, std::size_t size);
  TermData checked(const RowsArgument& rows, int count, int all);
  Frame kept(const FrameArgument& argument);
  const double* kept(const std::optional<Reading>& carrier);
  Anchorage kept(const AnchorageArgument& argument);

  std::vector<nanobind::object> kept_;
  std::vector<int> place_;
  std::unique_ptr<Engine> engine_;
};

/// Add what terms are handed over by.
void bind_terms(nanobind::module_& m);

}  // namespace rmrc
