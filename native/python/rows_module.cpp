// The rows of a step in Python: built from the arrays of its barriers, whose state they share.

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
#include "engine/shorten.hpp"
#include "limits/collision.hpp"
#include "limits/rows.hpp"
#include "limits/speed.hpp"
#include "limits/workspace.hpp"
#include "python/bindings.hpp"

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

// How many of each thing the arrays of kinematics are of.
struct Counts {
  std::size_t coordinates, mocaps, bodies, geoms, sites, dofs;
  bool operator==(const Counts&) const = default;
};

struct BoundKinematics {
  Kinematics arrays;
  Counts counts;
  nb::object data, kept;
};

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

class BoundRows {
 public:
  BoundRows(nb::handle engine, const BoundKinematics& now, Writing matrix, Writing lower, Writing upper, Writing multiplier, Integers ids,
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

  Rows& operator*() { return *rows_; }
  const Counts& counts() const { return counts_; }

  /// Have nothing added any more.
  void close() { closed_ = true; }

  void know(double resolution, std::vector<bool> turning,
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

  void add_speed(Reading position, Reading rotation, Reading reference, std::vector<int> dofs,
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

  void add_collision(double d_min, double detect, double gain, double push, Reading twist,
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

  void add_workspace(
      const std::vector<std::tuple<std::string, int, int, int, Numbers, double, std::vector<int>,
                                   Numbers>>& planes,
      double gain, double push, Reading twist) {
    require_open();
    require_twists(twist);
    std::vector<Plane> made;
    for (const auto& [kind, id, root, mocap, normal, offset, dofs, levers] : planes) {
      const Anchor anchor = kind == "site"   ? Anchor::site
                            : kind == "geom" ? Anchor::geom
                            : kind == "body"
                                ? Anchor::body
                                : throw std::invalid_argument("there is no frame of a " + kind);
      const std::size_t all = kind == "site"   ? counts_.sites
                              : kind == "geom" ? counts_.geoms
                                               : counts_.bodies;
      require_index(id, static_cast<std::int64_t>(all), "frame");
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

  void add_balls(const std::vector<std::tuple<int, int, double>>& balls, double gain,
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

  using TendonArgument =
      std::tuple<double, double, std::vector<int>, std::vector<int>, std::vector<double>>;

  void add_tendons(const std::vector<TendonArgument>& ends, double gain, double push) {
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

  std::vector<std::tuple<int, int>> kept_blocks() const {
    std::vector<std::tuple<int, int>> found;
    for (const Block& block : rows_->kept_blocks()) found.emplace_back(block.first, block.count);
    return found;
  }

  std::vector<std::tuple<int, int>> blocks() const {
    std::vector<std::tuple<int, int>> found;
    for (const Block& block : rows_->blocks()) found.emplace_back(block.first, block.count);
    return found;
  }

 private:
  // Who checks commands by the barriers has looked which there are.
  void require_open() const {
    if (closed_) throw std::invalid_argument("these rows are in use: nothing can be added");
  }

  void require_twists(const Reading& twist) const {
    require(twist, 6 * counts_.mocaps, "twist");
  }

  std::vector<nb::object> kept_;
  const double* v_previous_ = nullptr;  // of the engine's stack
  Counts counts_;
  bool closed_ = false;
  std::unique_ptr<Rows> rows_;
};

class BoundShortening {
 public:
  BoundShortening(nb::object rows, const BoundKinematics& own, Reading twist)
      : kept_{rows, own.data, own.kept, nb::cast(twist)},
        native_(checked(rows, own, twist), own.arrays, twist.data(),
                static_cast<int>(twist.size() / 6)) {}

  void follow(nb::object kinematics) {
    ForwardKinematics& native = kinematics_of(kinematics);
    if (native.coordinates() != native_.rows().mujoco().nq) {
      throw std::invalid_argument("the kinematics are another model's");
    }
    native_.follow(native);
    kept_.push_back(std::move(kinematics));
  }

  Shortening& operator*() { return native_; }

 private:
  static Rows& checked(nb::handle rows, const BoundKinematics& own, const Reading& twist) {
    Rows& native = rows_of(rows);
    if (own.counts != nb::cast<BoundRows&>(rows).counts()) {
      throw std::invalid_argument("the kinematics are another model's");
    }
    require(twist, 6 * own.counts.mocaps, "twist");
    return native;
  }

  std::vector<nb::object> kept_;
  Shortening native_;
};

}  // namespace

Rows& rows_of(nb::handle object) {
  auto& bound = nb::cast<BoundRows&>(object);
  bound.close();
  return *bound;
}

Shortening& shortening_of(nb::handle object) { return *nb::cast<BoundShortening&>(object); }

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
  nb::class_<BoundShortening>(m, "Shortening", "How much of a command may be carried out.")
      .def(nb::init<nb::object, const BoundKinematics&, Reading>(), nb::kw_only(), "rows"_a, "own"_a,
           "twist"_a.noconvert())
      .def("follow", &BoundShortening::follow, "kinematics"_a,
           "Place what the barriers look at by these, in place of MuJoCo's.")
      .def(
          "share",
          [](BoundShortening& bound, const Reading& v, const Reading& brake,
             double dt, double seconds) {
            const std::size_t n = (*bound).rows().dofs().size();
            require(v, n, "v");
            require(brake, n, "brake");
            const Share found = (*bound).share(v.data(), brake.data(), dt, end_after(seconds));
            return std::tuple(found.share, found.passed);
          },
          "v"_a, "brake"_a, "dt"_a, "seconds"_a,
          "Return how much of v keeps all distances, from the brake on, and whether one falls\n"
          "below its limit even so; nothing of it after so many seconds.");
}

}  // namespace rmrc
