// The rows of a step in Python: built from the arrays of its barriers, whose state they share.

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <cstdint>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "bindings.hpp"
#include "collision.hpp"
#include "engine.hpp"
#include "rows.hpp"
#include "shorten.hpp"
#include "speed.hpp"
#include "workspace.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace rmrc {

namespace {

using Integers = nb::ndarray<std::int64_t, nb::c_contig, nb::device::cpu>;

// Arrays by their names, each looked at for its type and its size.
class Fields {
 public:
  explicit Fields(nb::dict fields) : fields_(std::move(fields)) {}

  double* doubles(const char* name, std::size_t size) const { return get<double>(name, size); }
  std::int64_t* integers(const char* name, std::size_t size) const {
    return get<std::int64_t>(name, size);
  }
  std::uint8_t* flags(const char* name, std::size_t size) const {
    return reinterpret_cast<std::uint8_t*>(get<bool>(name, size));
  }
  std::size_t size(const char* name) const {
    return nb::cast<nb::ndarray<nb::ro, nb::device::cpu>>(fields_[name]).size();
  }

 private:
  template <class Number>
  Number* get(const char* name, std::size_t size) const {
    const auto array =
        nb::cast<nb::ndarray<Number, nb::c_contig, nb::device::cpu>>(fields_[name], false);
    if (array.size() != size) throw std::invalid_argument(std::string(name) + " has a wrong size");
    return array.data();
  }

  nb::dict fields_;
};

struct BoundKinematics {
  Kinematics arrays;
  nb::dict kept;
};

BoundKinematics make_kinematics(std::uintptr_t data, nb::dict arrays) {
  const Fields fields(arrays);
  const auto all = [&](const char* name) { return fields.doubles(name, fields.size(name)); };
  const Kinematics made{reinterpret_cast<void*>(data), all("qpos"),
                        all("mocap_pos"),  all("mocap_quat"), all("xpos"),
                        all("xquat"),      all("geom_xpos"),  all("geom_xmat"),
                        all("site_xpos"),  all("cdof"),       all("reference")};
  return {made, std::move(arrays)};
}

class BoundRows {
 public:
  BoundRows(nb::handle engine, const BoundKinematics& now, Numbers inverse_acceleration,
            Writing matrix, Writing lower, Writing upper, Writing multiplier, Integers ids,
            Writing distance, Writing slope, Writing drift)
      : kept_{now.kept,        nb::cast(matrix),   nb::cast(lower),
              nb::cast(upper), nb::cast(multiplier), nb::cast(ids),   nb::cast(distance),
              nb::cast(slope), nb::cast(drift)} {
    const Engine& native = engine_of(engine);
    const std::size_t capacity = lower.size(), n = native.size(), nv = native.mujoco().nv;
    if (matrix.size() != capacity * n || upper.size() != capacity ||
        multiplier.size() != capacity || ids.size() != capacity || distance.size() != capacity ||
        slope.size() != capacity * nv || drift.size() != capacity ||
        inverse_acceleration.size() != n) {
      throw std::invalid_argument("the rows' arrays do not fit each other");
    }
    const int* place = native.stack().place;
    rows_ = std::make_unique<Rows>(
        native.mujoco(), now.arrays, native.dofs(), std::vector<int>(place, place + nv),
        std::move(inverse_acceleration),
        RowArrays{matrix.data(), lower.data(), upper.data(), multiplier.data(), ids.data(),
                  distance.data(), slope.data(), drift.data()},
        static_cast<int>(capacity));
  }

  Rows& operator*() { return *rows_; }

  void add_speed(Reading position, Reading rotation, Reading reference, std::vector<int> dofs,
                 bool turned, double linear, double angular, Reading rate) {
    if (position.size() != 3 || rotation.size() != 9 || reference.size() != 3 ||
        rate.size() != 6) {
      throw std::invalid_argument("a frame has a wrong size");
    }
    for (const Reading* array : {&position, &rotation, &reference, &rate}) {
      kept_.push_back(nb::cast(*array));
    }
    rows_->add(SpeedRows({position.data(), rotation.data(), reference.data(), std::move(dofs)},
                         turned, linear, angular, rate.data(), rows_->mujoco().cdof));
  }

  void add_collision(double d_min, double detect, double gain, double push, Reading twist,
                     nb::dict arrays) {
    const Fields fields(arrays);
    PairArrays a{};
    const std::size_t p = fields.size("bound"), nv = rows_->mujoco().nv;
    const std::size_t width = nv + twist.size(), bodies = fields.size("reach");
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
    a.size = fields.doubles("size", fields.size("size"));
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
    a.position = fields.doubles("position", 3 * bodies);
    a.quaternion = fields.doubles("quaternion", 4 * bodies);
    a.seen_position = fields.doubles("seen_position", 3 * bodies);
    a.seen_quaternion = fields.doubles("seen_quaternion", 4 * bodies);
    kept_.push_back(nb::cast(twist));
    kept_.push_back(std::move(arrays));
    rows_->add(std::make_unique<Collision>(a, rows_->mujoco()));
  }

  void add_workspace(
      const std::vector<std::tuple<std::string, int, int, int, Numbers, double, std::vector<int>,
                                   Numbers>>& planes,
      double gain, double push, Reading twist) {
    std::vector<Plane> made;
    for (const auto& [kind, id, root, mocap, normal, offset, dofs, levers] : planes) {
      const Anchor anchor = kind == "site"   ? Anchor::site
                            : kind == "geom" ? Anchor::geom
                                             : Anchor::body;
      made.push_back({anchor, id, root, mocap, {normal.at(0), normal.at(1), normal.at(2)}, offset,
                      dofs, levers});
      if (levers.size() != rows_->mujoco().nv + twist.size()) {
        throw std::invalid_argument("levers has a wrong size");
      }
    }
    kept_.push_back(nb::cast(twist));
    rows_->add(std::make_unique<Workspace>(std::move(made), gain, push, twist.data(),
                                           rows_->mujoco().nv));
  }

  void add_balls(const std::vector<std::tuple<int, int, double>>& balls, double gain,
                 double push) {
    std::vector<Ball> made;
    for (const auto& [coordinate, dof, largest] : balls) made.push_back({coordinate, dof, largest});
    rows_->add(std::make_unique<BallRange>(std::move(made), gain, push, rows_->mujoco().nv));
  }

  std::vector<std::tuple<int, int>> blocks() const {
    std::vector<std::tuple<int, int>> found;
    for (const Block& block : rows_->blocks()) found.emplace_back(block.first, block.count);
    return found;
  }

 private:
  std::vector<nb::object> kept_;
  std::unique_ptr<Rows> rows_;
};

class BoundShortening {
 public:
  BoundShortening(nb::object rows, const BoundKinematics& own, Numbers deceleration, Reading twist)
      : kept_{rows, own.kept, nb::cast(twist)},
        native_(rows_of(rows), own.arrays, std::move(deceleration), twist.data(),
                static_cast<int>(twist.size() / 6)) {}

  void follow(nb::object kinematics) {
    native_.follow(kinematics_of(kinematics));
    kept_.push_back(std::move(kinematics));
  }

  Shortening& operator*() { return native_; }

 private:
  std::vector<nb::object> kept_;
  Shortening native_;
};

}  // namespace

Rows& rows_of(nb::handle object) { return *nb::cast<BoundRows&>(object); }

Shortening& shortening_of(nb::handle object) { return *nb::cast<BoundShortening&>(object); }

void bind_rows(nb::module_& m) {
  nb::class_<BoundKinematics>(m, "Kinematics", "Where the arrays of an mjData stand.")
      .def(nb::new_(&make_kinematics), "data"_a, "arrays"_a);
  nb::class_<BoundRows>(m, "Rows", "The rows of a step, in the arrays that it is given.")
      .def(nb::init<nb::handle, const BoundKinematics&, Numbers, Writing, Writing, Writing,
                    Writing, Integers, Writing, Writing, Writing>(),
           nb::kw_only(), "engine"_a, "now"_a, "inverse_acceleration"_a, "matrix"_a, "lower"_a,
           "upper"_a, "multiplier"_a, "ids"_a, "distance"_a, "slope"_a, "drift"_a)
      .def("add_speed", &BoundRows::add_speed, nb::kw_only(), "position"_a, "rotation"_a,
           "reference"_a, "dofs"_a, "turned"_a, "linear"_a, "angular"_a, "rate"_a)
      .def("add_collision", &BoundRows::add_collision, nb::kw_only(), "d_min"_a, "detect"_a,
           "gain"_a, "push"_a, "twist"_a, "arrays"_a)
      .def("add_workspace", &BoundRows::add_workspace, "planes"_a, "gain"_a, "push"_a, "twist"_a)
      .def("add_balls", &BoundRows::add_balls, "balls"_a, "gain"_a, "push"_a)
      .def(
          "update",
          [](BoundRows& bound, const Reading& lb, const Reading& ub, double dt) {
            const std::size_t n = (*bound).dofs().size();
            if (lb.size() != n || ub.size() != n) {
              throw std::invalid_argument("the box has a wrong size");
            }
            (*bound).update(lb.data(), ub.data(), dt);
          },
          "lb"_a, "ub"_a, "dt"_a, "Write the rows at the present kinematics.")
      .def_prop_ro("blocks", &BoundRows::blocks, "First row and number of rows of each barrier.")
      .def_prop_ro("count", [](BoundRows& bound) { return (*bound).count(); })
      .def_prop_ro("passed", [](BoundRows& bound) { return (*bound).passed(); });
  nb::class_<BoundShortening>(m, "Shortening", "How much of a command may be carried out.")
      .def(nb::init<nb::object, const BoundKinematics&, Numbers, Reading>(), nb::kw_only(),
           "rows"_a, "own"_a, "deceleration"_a, "twist"_a)
      .def("follow", &BoundShortening::follow, "kinematics"_a,
           "Place what the barriers look at by these, in place of MuJoCo's.")
      .def(
          "share",
          [](BoundShortening& bound, const Reading& v, const Reading& brake,
             double dt, double seconds) {
            const Share found = (*bound).share(v.data(), brake.data(), dt, end_after(seconds));
            return std::tuple(found.share, found.passed);
          },
          "v"_a, "brake"_a, "dt"_a, "seconds"_a,
          "Return how much of v keeps all distances, from the brake on, and whether one falls\n"
          "below its limit even so; nothing of it after so many seconds.");
}

}  // namespace rmrc
