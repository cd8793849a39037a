// The barriers among the rows in Python.

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "limits/collision.hpp"
#include "limits/workspace.hpp"
#include "python/bound_rows.hpp"

namespace nb = nanobind;

namespace rmrc {

namespace {

Anchor anchor_of(const std::string& kind) {
  if (kind == "site") return Anchor::site;
  if (kind == "body") return Anchor::body;
  if (kind == "geom") return Anchor::geom;
  throw std::invalid_argument("there is no frame of a " + kind);
}

std::size_t count_of(Anchor anchor, const Counts& counts) {
  switch (anchor) {
    case Anchor::site:
      return counts.sites;
    case Anchor::body:
      return counts.bodies;
    case Anchor::geom:
      return counts.geoms;
  }
  return 0;
}

}  // namespace

void BoundRows::add_collision(double d_min, double detect, double gain, double push, Reading twist,
                   const nb::dict& arrays) {
  require_open();
  nb::dict own = copied(arrays);
  const Fields fields(own);
  PairArrays a{};
  const std::size_t p = fields.size("bound"), nv = rows_->mujoco().nv;
  const std::size_t width = nv + twist.size(), bodies = fields.size("reach");
  require_twists(twist);
  require_countable(static_cast<std::int64_t>(p), static_cast<std::int64_t>(std::max<std::size_t>(width, 6)));
  if (bodies != counts_.bodies || bodies == 0) {
    throw std::invalid_argument("reach has a wrong size");
  }
  a.pairs = static_cast<int>(p);
  a.bodies = static_cast<int>(bodies);
  a.mocaps = static_cast<int>(twist.size() / 6);
  a.d_min = d_min;
  a.detect = detect;
  a.gain = gain;
  a.push = push;
  a.geoms = fields.integers("geoms", 2 * p);
  a.body = fields.integers("body", 2 * p);
  a.root = fields.integers("root", 2 * p);
  a.mocap = fields.integers("mocap", 2 * p);
  a.plane = fields.flags("plane", p);
  a.doubtful = fields.flags("doubtful", p);
  a.size = fields.doubles("size", 3 * counts_.geoms);
  a.radii = fields.doubles("radii", p);
  a.thickness = fields.doubles("thickness", p);
  a.levers = fields.doubles("levers", p * width);
  a.side = fields.doubles("side", p * nv);
  a.longest = fields.doubles("longest", width);
  a.dof_root = fields.integers("dof_root", nv);
  a.reach = fields.doubles("reach", bodies);
  a.base = fields.integers("base", p);
  a.other = fields.integers("other", p);
  a.spread = fields.doubles("spread", p);
  a.width = fields.doubles("width", p);
  a.sign = fields.doubles("sign", p);
  a.carries = fields.doubles("carries", p * nv);
  a.moves = fields.doubles("moves", p * nv);
  a.precision = fields.doubles("precision", 2);
  a.twist = twist.data();
  a.bound = fields.doubles("bound", p);
  a.threshold = fields.doubles("threshold", p);
  a.distance = fields.doubles("distance", p);
  a.segments = fields.doubles("segments", 6 * p);
  a.normals = fields.doubles("normals", 3 * p);
  a.active = fields.flags("active", p);
  a.measured = fields.flags("measured", p);
  a.room = fields.doubles("room", 1);
  a.travel = fields.doubles("travel", width);
  a.apart = fields.doubles("apart", p);
  a.contacts = fields.doubles("contacts", 36 * p);
  a.contact_count = fields.integers("contact_count", p);
  a.position = fields.doubles("position", 3 * bodies);
  a.quaternion = fields.doubles("quaternion", 4 * bodies);
  a.seen_position = fields.doubles("seen_position", 3 * bodies);
  a.seen_quaternion = fields.doubles("seen_quaternion", 4 * bodies);
  for (std::size_t k = 0; k < 2 * p; ++k) {
    require_index(a.geoms[k], static_cast<std::int64_t>(counts_.geoms), "geom");
    require_index(a.body[k], a.bodies, "body");
    require_index(a.root[k], a.bodies, "body");
    if (a.mocap[k] >= 0) require_index(a.mocap[k], a.mocaps, "mocap body");
  }
  for (std::size_t k = 0; k < p; ++k) {
    require_index(a.base[k], static_cast<std::int64_t>(counts_.geoms), "geom");
    require_index(a.other[k], static_cast<std::int64_t>(counts_.geoms), "geom");
    require_index(a.contact_count[k], 4, "number of contacts");
  }
  for (std::size_t k = 0; k < nv; ++k) require_index(a.dof_root[k], a.bodies, "body");
  kept_.push_back(nb::cast(twist));
  kept_.push_back(std::move(own));
  rows_->add(std::make_unique<Collision>(a, rows_->mujoco()));
}

void BoundRows::add_workspace(
    const std::vector<std::tuple<std::string, int, int, int, Numbers, double, std::vector<int>,
                                 Numbers>>& planes,
    double gain, double push, Reading twist) {
  require_open();
  require_twists(twist);
  std::vector<Plane> made;
  for (const auto& [kind, id, root, mocap, normal, offset, dofs, levers] : planes) {
    const Anchor anchor = anchor_of(kind);
    require_index(id, static_cast<std::int64_t>(count_of(anchor, counts_)), "frame");
    require_index(root, static_cast<std::int64_t>(counts_.bodies), "body");
    if (mocap >= 0) require_index(mocap, static_cast<std::int64_t>(counts_.mocaps), "mocap body");
    require_dofs(dofs, rows_->mujoco().nv);
    require(normal, 3, "a normal");
    made.push_back({anchor, id, root, mocap, {normal[0], normal[1], normal[2]}, offset,
                    dofs, levers});
    if (levers.size() != rows_->mujoco().nv + twist.size()) {
      throw std::invalid_argument("levers has a wrong size");
    }
  }
  kept_.push_back(nb::cast(twist));
  rows_->add(std::make_unique<Workspace>(std::move(made), gain, push, twist.data(),
                                         rows_->mujoco().nv));
}

void BoundRows::add_balls(const std::vector<std::tuple<int, int, double>>& balls, double gain,
               double push) {
  require_open();
  std::vector<Ball> made;
  for (const auto& [coordinate, dof, largest] : balls) {
    require_part(coordinate, 4, rows_->mujoco().nq, "coordinate");
    require_part(dof, 3, rows_->mujoco().nv, "dof");
    made.push_back({coordinate, dof, largest});
  }
  rows_->add(std::make_unique<BallRange>(std::move(made), gain, push, rows_->mujoco().nv));
}

void BoundRows::add_tendons(const std::vector<TendonArgument>& ends, double gain, double push) {
  require_open();
  std::vector<TendonEnd> made;
  for (const auto& [sign, bound, coordinates, dofs, coefficients] : ends) {
    for (const int coordinate : coordinates) {
      require_part(coordinate, 1, rows_->mujoco().nq, "coordinate");
    }
    require_dofs(dofs, rows_->mujoco().nv);
    if (dofs.size() != coordinates.size() || dofs.size() != coefficients.size()) {
      throw std::invalid_argument("a tendon has a coordinate, a dof and a number for each joint");
    }
    made.push_back({sign, bound, coordinates, dofs, coefficients});
  }
  rows_->add(std::make_unique<TendonRange>(std::move(made), gain, push, rows_->mujoco().nv));
}

}  // namespace rmrc
