// Forward kinematics in Python: built from the constants of a model and the arrays of its data.

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <memory>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "kinematics/kinematics.hpp"
#include "python/bindings.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace rmrc {

namespace {

using Vector = std::array<double, 3>;
using Quaternion = std::array<double, 4>;
using JointArgument = std::tuple<int, int, int, Vector, Vector, double>;
using BodyArgument =
    std::tuple<int, int, int, int, Vector, Quaternion, std::vector<JointArgument>>;
using AttachedArgument = std::tuple<int, int, bool, bool, Vector, Quaternion>;
using MassArgument = std::tuple<int, int, double, double, bool, Vector>;

void require(bool holds, const char* what) {
  if (!holds) throw std::invalid_argument(std::string("there is no such ") + what);
}

// The arrays by name, and how many of each thing they are of.
class PoseFields {
 public:
  explicit PoseFields(const nb::dict& fields) : fields_(fields) {
    arrays.qpos = get("qpos", 1, coordinates);
    arrays.mocap_pos = get("mocap_pos", 3, mocaps);
    arrays.mocap_quat = get("mocap_quat", 4, mocaps);
    arrays.xpos = get("xpos", 3, bodies);
    arrays.xquat = get("xquat", 4, bodies);
    arrays.xmat = get("xmat", 9, bodies);
    arrays.geom_xpos = get("geom_xpos", 3, geoms);
    arrays.geom_xmat = get("geom_xmat", 9, geoms);
    arrays.site_xpos = get("site_xpos", 3, sites);
    arrays.site_xmat = get("site_xmat", 9, sites);
    arrays.subtree_com = get("subtree_com", 3, bodies);
    arrays.cdof = get("cdof", 6, dofs);
  }

  PoseArrays arrays{};
  int coordinates = -1, mocaps = -1, bodies = -1, geoms = -1, sites = -1, dofs = -1;

 private:
  double* get(const char* name, int width, int& count) {
    const auto array = nb::cast<Writing>(fields_[name], false);
    require_countable(static_cast<std::int64_t>(array.size()), 1);
    const int found = static_cast<int>(array.size()) / width;
    if (count >= 0 && count != found) {
      throw std::invalid_argument(std::string(name) + " has a wrong size");
    }
    count = found;
    return array.data();
  }

  const nb::dict& fields_;
};

bool within(int index, int count) { return index >= 0 && index < count; }

Joint made(const JointArgument& argument, const PoseFields& fields) {
  const auto& [kind, coordinate, dof, axis, position, zero] = argument;
  require(within(kind, 4), "kind of joint");
  constexpr int coordinates[] = {7, 4, 1, 1}, dofs[] = {6, 3, 1, 1};
  require(coordinate >= 0 && coordinate + coordinates[kind] <= fields.coordinates, "coordinate");
  require(dof >= 0 && dof + dofs[kind] <= fields.dofs, "dof");
  Joint joint{};
  joint.kind = static_cast<JointKind>(kind);
  joint.coordinate = coordinate;
  joint.dof = dof;
  joint.zero = zero;
  std::copy(axis.begin(), axis.end(), joint.axis);
  std::copy(position.begin(), position.end(), joint.position);
  return joint;
}

Body made(const BodyArgument& argument, const PoseFields& fields) {
  const auto& [id, parent, root, mocap, position, quaternion, joints] = argument;
  require(within(id, fields.bodies) && within(parent, id) && within(root, fields.bodies), "body");
  require(mocap < fields.mocaps, "mocap body");
  Body body{};
  body.id = id;
  body.parent = parent;
  body.root = root;
  body.mocap = mocap;
  std::copy(position.begin(), position.end(), body.position);
  std::copy(quaternion.begin(), quaternion.end(), body.quaternion);
  for (const JointArgument& joint : joints) body.joints.push_back(made(joint, fields));
  return body;
}

std::vector<Attached> made(const std::vector<AttachedArgument>& arguments, int count, int bodies) {
  std::vector<Attached> all;
  for (const auto& [id, body, shifted, turned, position, quaternion] : arguments) {
    require(within(id, count) && within(body, bodies), "geom or site");
    Attached part{id, body, shifted, turned, {}, {}};
    std::copy(position.begin(), position.end(), part.position);
    std::copy(quaternion.begin(), quaternion.end(), part.quaternion);
    all.push_back(part);
  }
  return all;
}

class BoundForwardKinematics {
 public:
  BoundForwardKinematics(const nb::dict& arrays, const std::vector<BodyArgument>& bodies,
                         const std::vector<AttachedArgument>& geoms,
                         const std::vector<AttachedArgument>& sites,
                         const std::vector<MassArgument>& masses)
      : kept_(copied(arrays)) {
    const PoseFields fields(kept_);
    Placed placed;
    for (const BodyArgument& body : bodies) placed.bodies.push_back(made(body, fields));
    placed.geoms = made(geoms, fields.geoms, fields.bodies);
    placed.sites = made(sites, fields.sites, fields.bodies);
    for (const auto& [id, parent, mass, of_subtree, shifted, centre] : masses) {
      require(within(id, fields.bodies) && parent < id, "body");
      placed.masses.push_back(
          {id, parent, mass, of_subtree, shifted, {centre[0], centre[1], centre[2]}});
    }
    size_ = fields.coordinates;
    native_ = std::make_unique<ForwardKinematics>(std::move(placed), fields.arrays, size_);
  }

  void update(const Reading& q) {
    rmrc::require(q, static_cast<std::size_t>(size_), "q");
    native_->update(q.data());
  }

  ForwardKinematics& operator*() { return *native_; }

 private:
  nb::dict kept_;
  int size_ = 0;
  std::unique_ptr<ForwardKinematics> native_;
};

}  // namespace

ForwardKinematics& kinematics_of(nb::handle object) {
  return *nb::cast<BoundForwardKinematics&>(object);
}

void bind_kinematics(nb::module_& m) {
  nb::class_<BoundForwardKinematics>(m, "ForwardKinematics", "Places what a step looks at.")
      .def(nb::init<const nb::dict&, const std::vector<BodyArgument>&,
                    const std::vector<AttachedArgument>&, const std::vector<AttachedArgument>&,
                    const std::vector<MassArgument>&>(),
           nb::kw_only(), "arrays"_a, "bodies"_a, "geoms"_a, "sites"_a, "masses"_a)
      .def("update", &BoundForwardKinematics::update, "q"_a, "Go to a configuration.");
}

}  // namespace rmrc
