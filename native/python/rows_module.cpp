// The rows of a step in Python, but for its barriers.

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
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

#include "engine/engine.hpp"
#include "limits/speed.hpp"
#include "python/bound_rows.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace rmrc {

namespace {

BoundKinematics make_kinematics(nb::object data, const nb::dict& arrays) {
  nb::dict own = copied(arrays);  // which nobody else can take anything out of
  const Fields fields(own);
  const Counts counts{fields.size("qpos"),          fields.size("mocap_pos") / 3,
                      fields.size("xpos") / 3,      fields.size("geom_xpos") / 3,
                      fields.size("site_xpos") / 3, fields.size("cdof") / 6};
  const Kinematics made{address_of(data, "MjData"),
                        fields.doubles("qpos", counts.coordinates),
                        fields.doubles("mocap_pos", 3 * counts.mocaps),
                        fields.doubles("mocap_quat", 4 * counts.mocaps),
                        fields.doubles("xpos", 3 * counts.bodies),
                        fields.doubles("xquat", 4 * counts.bodies),
                        fields.doubles("geom_xpos", 3 * counts.geoms),
                        fields.doubles("geom_xmat", 9 * counts.geoms),
                        fields.doubles("site_xpos", 3 * counts.sites),
                        fields.doubles("cdof", 6 * counts.dofs),
                        fields.doubles("reference", 3 * counts.bodies)};
  return {made, counts, std::move(data), std::move(own)};
}

}  // namespace

BoundRows::BoundRows(nb::handle engine, const BoundKinematics& now, Writing matrix, Writing lower, Writing upper, Writing multiplier, Integers ids,
          Writing distance, Writing slope, Writing drift)
    : kept_(kept_by(engine)), counts_(now.counts) {
  for (const Writing* array :
       {&matrix, &lower, &upper, &multiplier, &distance, &slope, &drift}) {
    kept_.push_back(nb::cast(*array));
  }
  for (const nb::object& part : {nb::cast(ids), now.data, now.kept}) kept_.push_back(part);
  const Engine& native = engine_of(engine);
  if (counts_.coordinates != static_cast<std::size_t>(native.mujoco().nq) ||
      counts_.dofs != static_cast<std::size_t>(native.mujoco().nv)) {
    throw std::invalid_argument("the kinematics are another model's");
  }
  const std::size_t capacity = lower.size(), n = native.size(), nv = native.mujoco().nv;
  require_countable(static_cast<std::int64_t>(capacity), static_cast<std::int64_t>(nv));
  if (matrix.size() != capacity * n || upper.size() != capacity ||
      multiplier.size() != capacity || ids.size() != capacity || distance.size() != capacity ||
      slope.size() != capacity * nv || drift.size() != capacity) {
    throw std::invalid_argument("the rows' arrays do not fit each other");
  }
  const int* place = native.stack().place;
  v_previous_ = native.stack().v_previous;
  rows_ = std::make_unique<Rows>(
      native.mujoco(), now.arrays, native.dofs(), std::vector<int>(place, place + nv),
      native.joint_limits(), native.stack().v_previous,
      RowArrays{matrix.data(), lower.data(), upper.data(), multiplier.data(), ids.data(),
                distance.data(), slope.data(), drift.data()},
      static_cast<int>(capacity));
}

void BoundRows::know(double resolution, std::vector<bool> turning,
          const std::vector<std::tuple<int, int, double, double, int, std::vector<int>>>& slides,
          Reading twist) {
  const MuJoCo& mujoco = rows_->mujoco();
  std::vector<Slide> made;
  for (const auto& [coordinate, dof, zero, counted, mocap, before] : slides) {
    require_index(coordinate, mujoco.nq, "coordinate");
    require_index(dof, mujoco.nv, "dof");
    require_index(mocap + 1, static_cast<int>(counts_.mocaps) + 1, "mocap");
    for (const int above : before) require_index(above, mujoco.nv, "dof");
    made.push_back({coordinate, dof, zero, counted, mocap, before});
  }
  require_twists(twist);
  if (turning.size() != static_cast<std::size_t>(mujoco.nv)) {
    throw std::invalid_argument("turning has a wrong size");
  }
  kept_.push_back(nb::cast(twist));
  rows_->know(resolution, std::move(turning), Slides(std::move(made), twist.data()));
}

void BoundRows::add_speed(Reading position, Reading rotation, Reading reference, std::vector<int> dofs,
               bool turned, double linear, double angular, Reading rate) {
  if (position.size() != 3 || rotation.size() != 9 || reference.size() != 3 ||
      rate.size() != 6) {
    throw std::invalid_argument("a frame has a wrong size");
  }
  require_open();
  require_dofs(dofs, rows_->mujoco().nv);
  for (const Reading* array : {&position, &rotation, &reference, &rate}) {
    kept_.push_back(nb::cast(*array));
  }
  rows_->add(SpeedRows({position.data(), rotation.data(), reference.data(), std::move(dofs)},
                       turned, linear, angular, rate.data(), v_previous_, rows_->place(),
                       static_cast<int>(rows_->dofs().size()), rows_->mujoco().cdof));
}

Rows& rows_of(nb::handle object) {
  auto& bound = nb::cast<BoundRows&>(object);
  bound.close();
  return *bound;
}

void bind_rows(nb::module_& m) {
  nb::class_<BoundKinematics>(m, "Kinematics", "Where the arrays of an mjData stand.")
      .def(nb::new_(&make_kinematics), "data"_a, "arrays"_a);
  nb::class_<BoundRows>(m, "Rows", "The rows of a step, in the arrays that it is given.")
      .def(nb::init<nb::handle, const BoundKinematics&, Writing, Writing, Writing, Writing,
                    Integers, Writing, Writing, Writing>(),
           nb::kw_only(), "engine"_a, "now"_a, "matrix"_a.noconvert(),
           "lower"_a.noconvert(), "upper"_a.noconvert(), "multiplier"_a.noconvert(),
           "ids"_a.noconvert(), "distance"_a.noconvert(), "slope"_a.noconvert(),
           "drift"_a.noconvert())
      .def("know", &BoundRows::know, nb::kw_only(), "resolution"_a, "turning"_a, "slides"_a,
           "twist"_a.noconvert())
      .def("add_speed", &BoundRows::add_speed, nb::kw_only(), "position"_a.noconvert(),
           "rotation"_a.noconvert(), "reference"_a.noconvert(), "dofs"_a, "turned"_a, "linear"_a,
           "angular"_a, "rate"_a.noconvert())
      .def("add_collision", &BoundRows::add_collision, nb::kw_only(), "d_min"_a, "detect"_a,
           "gain"_a, "push"_a, "twist"_a.noconvert(), "arrays"_a)
      .def("add_workspace", &BoundRows::add_workspace, "planes"_a, "gain"_a, "push"_a,
           "twist"_a.noconvert())
      .def("add_balls", &BoundRows::add_balls, "balls"_a, "gain"_a, "push"_a)
      .def("add_tendons", &BoundRows::add_tendons, "ends"_a, "gain"_a, "push"_a)
      .def(
          "update",
          [](BoundRows& bound, const Reading& lb, const Reading& ub, double dt) {
            const std::size_t n = (*bound).dofs().size();
            require(lb, n, "lb");
            require(ub, n, "ub");
            (*bound).update(lb.data(), ub.data(), dt);
          },
          "lb"_a, "ub"_a, "dt"_a, "Write the rows at the present kinematics.")
      .def_prop_ro("blocks", &BoundRows::blocks, "First row and number of rows of each barrier.")
      .def_prop_ro("kept_blocks", &BoundRows::kept_blocks,
                   "The same of those that bound their distances from above.")
      .def_prop_ro("count", [](BoundRows& bound) { return (*bound).count(); })
      .def_prop_ro("passed", [](BoundRows& bound) { return (*bound).passed(); });
  bind_shortening(m);
}

}  // namespace rmrc
