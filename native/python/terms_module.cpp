// The terms of the engine in Python.

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cstdint>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "python/bound_engine.hpp"
#include "tasks/axis.hpp"
#include "tasks/centre_of_mass.hpp"
#include "tasks/coupling.hpp"
#include "tasks/frame_terms.hpp"
#include "tasks/relative_frame.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace rmrc {

namespace {

Combination combination_of(const SumArgument& argument) {
  Combination combination{{}, std::get<1>(argument)};
  for (const auto& [coordinate, dof, coefficient] : std::get<0>(argument)) {
    combination.parts.push_back({coordinate, dof, coefficient});
  }
  return combination;
}

// How many numbers the target of a term on the joints has.
std::size_t target_size(JointTask task, const MuJoCo& mujoco) {
  switch (task) {
    case JointTask::posture:
      return static_cast<std::size_t>(mujoco.nq);
    case JointTask::velocity:
      return static_cast<std::size_t>(mujoco.nv);
    case JointTask::smooth:
    case JointTask::foreign:
      return 0;
  }
  return 0;
}

RowsArgument make_rows(int first, int count, double gain, Numbers root, Reading target,
                       Reading twist, Flags moving,
                       const std::vector<std::tuple<int, int, double>>& clamps,
                       const std::vector<std::tuple<int, int, bool, double>>& way, Numbers exact_root) {
  require(twist, 6, "twist");
  require(moving, 1, "moving");
  RowsArgument rows{{first, count, gain, target.data(), twist.data(), moving.data(), {}},
                    std::move(root),
                    target,
                    twist,
                    moving,
                    {},
                    std::move(exact_root)};
  for (const auto& [dof, before, turns, unit] : way) {
    if (before < -1 || before >= static_cast<int>(rows.way.size()) || !(unit > 0.0)) {
      throw std::invalid_argument("a way has a wrong order or a wrong unit");
    }
    rows.way.push_back({dof, before, turns, unit});
  }
  for (const auto& [at, size, longest] : clamps) {
    require_part(at, size, count, "row to clamp");
    rows.data.clamps.push_back({at, size, longest});
  }
  return rows;
}

FrameArgument make_frame(Reading position, Reading rotation, Reading reference,
                         std::vector<int> dofs, std::optional<Reading> carrier) {
  require(position, 3, "position");
  require(rotation, 9, "rotation");
  require(reference, 3, "reference");
  if (carrier) require(*carrier, 6, "carrier");
  return {{position.data(), rotation.data(), reference.data(), std::move(dofs),
           carrier ? carrier->data() : nullptr},
          position,
          rotation,
          reference,
          carrier};
}

}  // namespace

// Add a term with so many rows, whose target has at least so many numbers.
template <class Term, class... Arguments>
void BoundEngine::add(const RowsArgument& rows, int count, std::size_t target, Arguments&&... arguments) {
  const auto size = static_cast<std::size_t>(count);
  if (rows.root.size() != size && rows.root.size() != size * size) {
    throw std::invalid_argument("the root of the weight has a wrong size");
  }
  require_target(rows, target);
  auto term = std::make_unique<Term>(checked(rows, count, engine_->stack().rows), rows.root,
                                     std::forward<Arguments>(arguments)..., engine_->mujoco(),
                                     engine_->stack());
  if (!rows.exact_root.empty() && rows.exact_root.size() != size && rows.exact_root.size() != size * size) {
    throw std::invalid_argument("what counts of the rows has a wrong size");
  }
  term->bend(rows.way, rows.exact_root);
  engine_->add(std::move(term));
}

void BoundEngine::require_target(const RowsArgument& rows, std::size_t size) {
  if (rows.target.size() < size) throw std::invalid_argument("the target has a wrong size");
}

TermData BoundEngine::checked(const RowsArgument& rows, int count, int all) {
  if (rows.data.rows != count) throw std::invalid_argument("a term has a wrong number of rows");
  require_part(rows.data.first, count, all, "row");
  kept_.push_back(nb::cast(rows.target));
  kept_.push_back(nb::cast(rows.twist));
  kept_.push_back(nb::cast(rows.moving));
  return rows.data;
}

Frame BoundEngine::kept(const FrameArgument& argument) {
  require_dofs(argument.frame.dofs, engine_->mujoco().nv);
  kept_.push_back(nb::cast(argument.position));
  kept_.push_back(nb::cast(argument.rotation));
  kept_.push_back(nb::cast(argument.reference));
  kept(argument.carrier);
  return argument.frame;
}

const double* BoundEngine::kept(const std::optional<Reading>& carrier) {
  if (!carrier) return nullptr;
  require(*carrier, 6, "carrier");
  kept_.push_back(nb::cast(*carrier));
  return carrier->data();
}

Anchorage BoundEngine::kept(const AnchorageArgument& argument) {
  const auto& [frame, quaternion, point, turn] = argument;
  require(quaternion, 4, "quaternion");
  require(point, 3, "point");
  require(turn, 4, "turn");
  kept_.push_back(nb::cast(quaternion));
  Anchorage anchorage{kept(frame), quaternion.data(), {}, {}};
  std::copy_n(point.begin(), 3, anchorage.point);
  std::copy_n(turn.begin(), 4, anchorage.turn);
  return anchorage;
}

void BoundEngine::add_frame(const RowsArgument& rows, const FrameArgument& frame) {
  add<BodyFrame>(rows, 6, 7, kept(frame));
}

void BoundEngine::add_world_frame(const RowsArgument& rows, const FrameArgument& frame) {
  add<WorldFrame>(rows, 6, 7, kept(frame));
}

void BoundEngine::add_relative(const RowsArgument& rows, const FrameArgument& frame,
                  const FrameArgument& root) {
  add<RelativeFrame>(rows, 6, 7, kept(frame), kept(root));
}

void BoundEngine::add_axis(const RowsArgument& rows, const FrameArgument& frame, const Numbers& axis,
              bool at_point) {
  require(axis, 3, "axis");
  add<Axis>(rows, 3, 3, kept(frame), axis.data(), at_point);
}

void BoundEngine::add_com(const RowsArgument& rows,
             const std::vector<std::tuple<int, double, Reading, Reading>>& moved,
             const std::vector<std::tuple<double, Reading, Reading, std::optional<Reading>>>&
                 parts) {
  std::vector<MovedMass> masses;
  for (const auto& [dof, share, point, reference] : moved) {
    require_index(dof, engine_->mujoco().nv, "dof");
    require(point, 3, "a centre of mass");
    require(reference, 3, "a reference");
    masses.push_back({dof, share, point.data(), reference.data()});
    kept_.push_back(nb::cast(point));
    kept_.push_back(nb::cast(reference));
  }
  std::vector<Subtree> subtrees;
  for (const auto& [share, centre, reference, carrier] : parts) {
    require(centre, 3, "a centre of mass");
    require(reference, 3, "a reference");
    subtrees.push_back({share, centre.data(), reference.data(), kept(carrier)});
    kept_.push_back(nb::cast(centre));
    kept_.push_back(nb::cast(reference));
  }
  add<CentreOfMass>(rows, 3, 3, std::move(masses), std::move(subtrees));
}

void BoundEngine::add_coupling(const RowsArgument& rows, const Numbers& by_coordinate, const Numbers& by_dof,
                  double offset) {
  require(by_coordinate, static_cast<std::size_t>(engine_->mujoco().nq), "by_coordinate");
  require(by_dof, static_cast<std::size_t>(engine_->mujoco().nv), "by_dof");
  add<Coupling>(rows, 1, 0, by_coordinate, by_dof, offset);
}

void BoundEngine::add_loop(const RowsArgument& rows, const std::vector<PairArgument>& pairs,
              const std::vector<PolynomialArgument>& polynomials, const Numbers& scale,
              const std::vector<bool>& angular) {
  const int count = rows.data.rows;
  require(scale, static_cast<std::size_t>(count), "scale");
  require(angular, static_cast<std::size_t>(count), "angular");
  std::vector<BodyPair> made;
  for (const auto& [first, welded, torque_scale, one, other] : pairs) {
    require_part(first, welded ? 6 : 3, count, "row");
    made.push_back({first, welded, torque_scale, {kept(one), kept(other)}});
  }
  std::vector<Polynomial> lines;
  for (const auto& [first, y, x, coefficients] : polynomials) {
    require(coefficients, 5, "a polynomial");
    require_index(first, count, "row");
    for (const SumArgument* side : {&y, &x}) {
      for (const auto& [coordinate, dof, coefficient] : std::get<0>(*side)) {
        require_index(coordinate, engine_->mujoco().nq, "coordinate");
        require_index(dof, engine_->mujoco().nv, "dof");
      }
    }
    lines.push_back({first, combination_of(y), combination_of(x), {}});
    std::copy_n(coefficients.begin(), 5, lines.back().coefficients);
  }
  add<Loop>(rows, count, 0, std::move(made), std::move(lines), scale,
            std::vector<char>(angular.begin(), angular.end()));
}

void BoundEngine::add_foreign(const RowsArgument& rows) { add<ForeignRows>(rows, rows.data.rows, 0); }

void BoundEngine::add_joint_task(const RowsArgument& rows, const std::string& kind,
                    const std::vector<int>& wrapped) {
  const auto nv = static_cast<std::size_t>(engine_->mujoco().nv);
  if (rows.root.size() != nv && rows.root.size() != nv * nv) {
    throw std::invalid_argument("the weight has a wrong size");
  }
  const JointTask task = kind == "posture"    ? JointTask::posture
                         : kind == "velocity" ? JointTask::velocity
                         : kind == "smooth"   ? JointTask::smooth
                         : kind == "foreign"
                             ? JointTask::foreign
                             : throw std::invalid_argument("there is no task " + kind);
  require_target(rows, target_size(task, engine_->mujoco()));
  for (const int dof : wrapped) require_index(dof, engine_->mujoco().nv, "dof");
  engine_->add(JointTerm{checked(rows, static_cast<int>(nv), engine_->stack().errors), task,
                         rows.root, wrapped});
}

void bind_terms(nb::module_& m) {
  nb::class_<RowsArgument>(m, "TermRows", "What all terms of an engine have.")
      .def(nb::new_(&make_rows), "first"_a, "count"_a, "gain"_a, "root"_a, "target"_a.noconvert(),
           "twist"_a.noconvert(), "moving"_a.noconvert(),
           "clamps"_a = std::vector<std::tuple<int, int, double>>(),
           "way"_a = std::vector<std::tuple<int, int, bool, double>>(), "exact_root"_a = Numbers());
  nb::class_<FrameArgument>(m, "Frame", "Where the pose of a frame stands, and what moves it.")
      .def(nb::new_(&make_frame), "position"_a.noconvert(), "rotation"_a.noconvert(),
           "reference"_a.noconvert(), "dofs"_a, "carrier"_a.noconvert().none());
}

}  // namespace rmrc
