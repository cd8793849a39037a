// The engine in Python: built from the arrays of an `Evaluation` and an `Assembly`, which it fills.

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
#include "python/bindings.hpp"
#include "tasks/loop.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace rmrc {

namespace {

template <class Function>
Function function(std::uintptr_t address) {
  if (address == 0) throw std::invalid_argument("a function of MuJoCo's is missing");
  return reinterpret_cast<Function>(address);
}

// The parts that Python names, with the arrays that they point into.
struct RowsArgument {
  TermData data;
  Numbers root;
  Reading target, twist;
  Flags moving;
  std::vector<WayJoint> way;
  Numbers exact_root;
};

struct FrameArgument {
  Frame frame;
  Reading position, rotation, reference;
  std::optional<Reading> carrier;
};

// The engine, and the arrays of Python's that it points into.
using AnchorageArgument = std::tuple<FrameArgument, Reading, Numbers, Numbers>;
using PairArgument = std::tuple<int, bool, double, AnchorageArgument, AnchorageArgument>;
using SumArgument = std::tuple<std::vector<std::tuple<int, int, double>>, double>;
using PolynomialArgument = std::tuple<int, SumArgument, SumArgument, Numbers>;

Combination combination_of(const SumArgument& argument) {
  Combination combination{{}, std::get<1>(argument)};
  for (const auto& [coordinate, dof, coefficient] : std::get<0>(argument)) {
    combination.parts.push_back({coordinate, dof, coefficient});
  }
  return combination;
}

class BoundEngine {
 public:
  BoundEngine(const std::vector<std::uintptr_t>& functions, nb::object model, nb::object data,
              Writing qpos, Reading cdof, Writing error, Writing feedforward,
              Writing rate, Writing jacobian, Reading v_previous, Reading a_previous,
              std::vector<int> dofs, Numbers hessian, double unit, double share_of_inertia,
              double floor, double least_curvature,
              bool brakes, double soft_ratio,
              const std::tuple<std::vector<int>, Numbers, Numbers, double, Numbers, Numbers,
                               Numbers, Numbers>& limits,
              Writing H, Writing g, Writing added_damping, Writing inertia, Writing lb, Writing ub,
              int max_iter)
      : kept_{model,               data,
              nb::cast(qpos),      nb::cast(cdof),       nb::cast(error),     nb::cast(feedforward),
              nb::cast(rate),      nb::cast(jacobian),   nb::cast(v_previous), nb::cast(a_previous),
              nb::cast(H),         nb::cast(g),          nb::cast(added_damping),
              nb::cast(inertia),   nb::cast(lb),         nb::cast(ub)} {
    const std::size_t n = dofs.size(), nv = v_previous.size();
    if (functions.size() != 7) throw std::invalid_argument("seven functions are needed");
    if (max_iter < 1) throw std::invalid_argument("max_iter is out of range");
    require(qpos, nb::cast<std::size_t>(model.attr("nq")), "qpos");
    require(v_previous, nb::cast<std::size_t>(model.attr("nv")), "v_previous");
    require_countable(std::max(nv, error.size()) + 4, nv + 4);
    if (n == 0) throw std::invalid_argument("there is no dof");
    require_dofs(dofs, static_cast<int>(nv));
    if (jacobian.size() % nv != 0 || jacobian.size() / nv > error.size()) {
      throw std::invalid_argument("jacobian has a wrong size");
    }
    require(cdof, 6 * nv, "cdof");
    require(a_previous, nv, "a_previous");
    require(feedforward, error.size(), "feedforward");
    require(rate, error.size(), "rate");
    require(hessian, n * n, "hessian");
    require(H, n * n, "H");
    require(added_damping, 1, "added_damping");
    require(inertia, nv * nv, "inertia");
    for (const Writing* array : {&g, &lb, &ub}) require(*array, n, "the program");
    place_.assign(nv, -1);
    for (std::size_t k = 0; k < n; ++k) place_[dofs[k]] = static_cast<int>(k);
    const MuJoCo mujoco{
        {function<void (*)(const void*, void*)>(functions[0]),
         function<void (*)(const void*, void*)>(functions[1]),
         function<void (*)(const void*, void*)>(functions[2]),
         function<void (*)(const void*, const void*, double*)>(functions[3]),
         function<void (*)(const void*, double*, const double*, double)>(functions[4]),
         function<void (*)(const void*, double*, double, const double*, const double*)>(
             functions[5]),
         function<double (*)(const void*, const void*, int, int, double, double*)>(functions[6])},
        address_of(model, "MjModel"),
        address_of(data, "MjData"),
        static_cast<int>(qpos.size()),
        static_cast<int>(nv),
        qpos.data(),
        cdof.data()};
    const auto& [coordinate, lower, upper, gain, velocity, acceleration, jerk, step] = limits;
    for (const Numbers* values : {&lower, &upper, &velocity, &acceleration, &jerk, &step}) {
      require(*values, n, "a limit");
    }
    require(coordinate, n, "a limit");
    for (const int at : coordinate) require_index(at, mujoco.nq, "coordinate");
    for (const double a : acceleration) {
      if (!(a > 0.0)) throw std::invalid_argument("an acceleration is not positive");
    }
    engine_ = std::make_unique<Engine>(
        mujoco,
        Stack{error.data(), feedforward.data(), jacobian.data(), v_previous.data(), place_.data(),
              static_cast<int>(error.size()), static_cast<int>(jacobian.size() / nv)},
        ProgramArrays{H.data(), g.data(), lb.data(), ub.data(), rate.data(),
                      added_damping.data(), inertia.data(), a_previous.data()},
        Constants{std::move(dofs), std::move(hessian), unit, share_of_inertia, floor, least_curvature,
                  brakes, soft_ratio},
        JointLimits{coordinate, lower, upper, gain, velocity, acceleration, jerk, step},
        max_iter);
  }

  void limit(nb::object rows, nb::object shortening) {
    require_no_levels(*engine_);
    Rows& limits = rows_of(rows);
    Shortening* check = shortening.is_none() ? nullptr : &shortening_of(shortening);
    const MuJoCo &own = engine_->mujoco(), &other = limits.mujoco();
    if (other.model != own.model || other.data != own.data || limits.dofs() != engine_->dofs() ||
        (check != nullptr && &check->rows() != &limits)) {
      throw std::invalid_argument("the rows are another engine's");
    }
    engine_->limit(limits, check);
    kept_.push_back(std::move(rows));
    kept_.push_back(std::move(shortening));
  }

  void follow(nb::object kinematics) {
    ForwardKinematics& native = kinematics_of(kinematics);
    if (native.coordinates() != engine_->mujoco().nq) {
      throw std::invalid_argument("the kinematics are another model's");
    }
    engine_->follow(native);
    kept_.push_back(std::move(kinematics));
  }

  const std::vector<nb::object>& kept() const { return kept_; }

  Engine& operator*() { return *engine_; }
  const Engine& operator*() const { return *engine_; }

  void add_frame(const RowsArgument& rows, const FrameArgument& frame) {
    add<BodyFrame>(rows, 6, 7, kept(frame));
  }

  void add_world_frame(const RowsArgument& rows, const FrameArgument& frame) {
    add<WorldFrame>(rows, 6, 7, kept(frame));
  }

  void add_relative(const RowsArgument& rows, const FrameArgument& frame,
                    const FrameArgument& root) {
    add<RelativeFrame>(rows, 6, 7, kept(frame), kept(root));
  }

  void add_axis(const RowsArgument& rows, const FrameArgument& frame, const Numbers& axis,
                bool at_point) {
    require(axis, 3, "axis");
    add<Axis>(rows, 3, 3, kept(frame), axis.data(), at_point);
  }

  void add_com(const RowsArgument& rows,
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

  void add_coupling(const RowsArgument& rows, const Numbers& by_coordinate, const Numbers& by_dof,
                    double offset) {
    require(by_coordinate, static_cast<std::size_t>(engine_->mujoco().nq), "by_coordinate");
    require(by_dof, static_cast<std::size_t>(engine_->mujoco().nv), "by_dof");
    add<Coupling>(rows, 1, 0, by_coordinate, by_dof, offset);
  }

  void add_loop(const RowsArgument& rows, const std::vector<PairArgument>& pairs,
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

  void add_foreign(const RowsArgument& rows) { add<ForeignRows>(rows, rows.data.rows, 0); }

  void add_joint_task(const RowsArgument& rows, const std::string& kind,
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
    const std::size_t target = task == JointTask::posture    ? engine_->mujoco().nq
                               : task == JointTask::velocity ? nv
                                                             : 0;
    require_target(rows, target);
    for (const int dof : wrapped) require_index(dof, engine_->mujoco().nv, "dof");
    engine_->add(JointTerm{checked(rows, static_cast<int>(nv), engine_->stack().errors), task,
                           rows.root, wrapped});
  }

  void adapt(const std::string& rule, double threshold, double largest, int rank, double scale,
             const std::vector<std::tuple<int, int>>& rows) {
    const Adapt adapt = rule == "sigma_min"        ? Adapt::sigma_min
                        : rule == "manipulability" ? Adapt::manipulability
                        : rule == "error"
                            ? Adapt::error
                            : throw std::invalid_argument("there is no rule " + rule);
    std::vector<TaskedRow> tasked;
    for (const auto& [term, row] : rows) {
      const auto& terms = engine_->row_terms();
      if (term < 0 || term >= static_cast<int>(terms.size()) || row < 0 ||
          row >= terms[term]->data().rows) {
        throw std::invalid_argument("there is no such row");
      }
      tasked.push_back({term, row});
    }
    require_part(0, rank, std::min<std::int64_t>(std::ssize(rows), engine_->size()), "rank");
    engine_->adapt({adapt, threshold, largest, rank, scale}, std::move(tasked));
  }

 private:
  // Add a term with so many rows, whose target has at least so many numbers.
  template <class Term, class... Arguments>
  void add(const RowsArgument& rows, int count, std::size_t target, Arguments&&... arguments) {
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

  static void require_target(const RowsArgument& rows, std::size_t size) {
    if (rows.target.size() < size) throw std::invalid_argument("the target has a wrong size");
  }

  TermData checked(const RowsArgument& rows, int count, int all) {
    if (rows.data.rows != count) throw std::invalid_argument("a term has a wrong number of rows");
    require_part(rows.data.first, count, all, "row");
    kept_.push_back(nb::cast(rows.target));
    kept_.push_back(nb::cast(rows.twist));
    kept_.push_back(nb::cast(rows.moving));
    return rows.data;
  }

  Frame kept(const FrameArgument& argument) {
    require_dofs(argument.frame.dofs, engine_->mujoco().nv);
    kept_.push_back(nb::cast(argument.position));
    kept_.push_back(nb::cast(argument.rotation));
    kept_.push_back(nb::cast(argument.reference));
    kept(argument.carrier);
    return argument.frame;
  }

  const double* kept(const std::optional<Reading>& carrier) {
    if (!carrier) return nullptr;
    require(*carrier, 6, "carrier");
    kept_.push_back(nb::cast(*carrier));
    return carrier->data();
  }

  Anchorage kept(const AnchorageArgument& argument) {
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

  std::vector<nb::object> kept_;
  std::vector<int> place_;
  std::unique_ptr<Engine> engine_;
};

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

void evaluate(BoundEngine& bound, const Reading& q) {
  require(q, static_cast<std::size_t>((*bound).mujoco().nq), "q");
  (*bound).evaluate(q.data());
}

nb::tuple solve(BoundEngine& bound, const std::optional<Reading>& q, double dt, double seconds,
                const Writing& solution) {
  Engine& engine = *bound;
  const std::size_t n = engine.size();
  if (q) require(*q, static_cast<std::size_t>(engine.mujoco().nq), "q");
  require(solution, 2 * n, "solution");
  const Ending ending = engine.solve(q ? q->data() : nullptr, dt, seconds);
  std::copy_n(engine.v(), n, solution.data());
  std::copy_n(engine.bound_multiplier(), n, solution.data() + n);
  const Residuals& kkt = engine.residuals();
  return nb::make_tuple(name_of(ending), engine.iterations(), kkt.primal, kkt.dual,
                        kkt.complementarity, engine.outside(), engine.share(), engine.relaxed());
}

}  // namespace

Engine& engine_of(nb::handle object) { return *nb::cast<BoundEngine&>(object); }

const std::vector<nb::object>& kept_by(nb::handle engine) {
  return nb::cast<BoundEngine&>(engine).kept();
}

void* address_of(nb::handle object, const char* type) {
  const nb::object known = nb::module_::import_("mujoco").attr(type);
  if (!nb::isinstance(object, known)) {
    throw std::invalid_argument(std::string("this is no ") + type);
  }
  return reinterpret_cast<void*>(nb::cast<std::uintptr_t>(object.attr("_address")));
}

void require_no_levels(const Engine& engine) {
  if (engine.cascaded()) throw std::invalid_argument("the levels come last");
}

void bind_engine(nb::module_& m) {
  nb::class_<RowsArgument>(m, "TermRows", "What all terms of an engine have.")
      .def(nb::new_(&make_rows), "first"_a, "count"_a, "gain"_a, "root"_a, "target"_a.noconvert(),
           "twist"_a.noconvert(), "moving"_a.noconvert(),
           "clamps"_a = std::vector<std::tuple<int, int, double>>(),
           "way"_a = std::vector<std::tuple<int, int, bool, double>>(), "exact_root"_a = Numbers());
  nb::class_<FrameArgument>(m, "Frame", "Where the pose of a frame stands, and what moves it.")
      .def(nb::new_(&make_frame), "position"_a.noconvert(), "rotation"_a.noconvert(),
           "reference"_a.noconvert(), "dofs"_a, "carrier"_a.noconvert().none());
  nb::class_<BoundEngine>(m, "Engine", "The whole step, in the arrays that it is given.")
      .def(nb::init<const std::vector<std::uintptr_t>&, nb::object, nb::object, Writing,
                    Reading, Writing, Writing, Writing, Writing, Reading, Reading,
                    std::vector<int>, Numbers, double, double, double, double, bool, double,
                    const std::tuple<std::vector<int>, Numbers, Numbers, double, Numbers, Numbers,
                                     Numbers, Numbers>&,
                    Writing, Writing, Writing, Writing, Writing, Writing, int>(),
           nb::kw_only(), "functions"_a, "model"_a, "data"_a, "qpos"_a.noconvert(),
           "cdof"_a.noconvert(), "error"_a.noconvert(), "feedforward"_a.noconvert(),
           "rate"_a.noconvert(), "jacobian"_a.noconvert(), "v_previous"_a.noconvert(),
           "a_previous"_a.noconvert(), "dofs"_a, "hessian"_a, "unit"_a, "share_of_inertia"_a,
           "floor"_a, "least_curvature"_a, "brakes"_a, "soft_ratio"_a, "limits"_a, "H"_a.noconvert(), "g"_a.noconvert(),
           "added_damping"_a.noconvert(), "inertia"_a.noconvert(), "lb"_a.noconvert(),
           "ub"_a.noconvert(), "max_iter"_a)
      .def("add_frame", &BoundEngine::add_frame, "rows"_a, "frame"_a)
      .def("add_world_frame", &BoundEngine::add_world_frame, "rows"_a, "frame"_a)
      .def("add_relative", &BoundEngine::add_relative, "rows"_a, "frame"_a, "root"_a)
      .def("add_axis", &BoundEngine::add_axis, "rows"_a, "frame"_a, "axis"_a, "at_point"_a)
      .def("add_com", &BoundEngine::add_com, "rows"_a, "moved"_a.noconvert(), "parts"_a.noconvert())
      .def("add_coupling", &BoundEngine::add_coupling, "rows"_a, "by_coordinate"_a, "by_dof"_a,
           "offset"_a)
      .def("add_loop", &BoundEngine::add_loop, "rows"_a, "pairs"_a.noconvert(),
           "polynomials"_a, "scale"_a, "angular"_a)
      .def("add_foreign", &BoundEngine::add_foreign, "rows"_a)
      .def("add_joint_task", &BoundEngine::add_joint_task, "rows"_a, "kind"_a, "wrapped"_a)
      .def("adapt", &BoundEngine::adapt, "rule"_a, "threshold"_a, "largest"_a, "rank"_a, "scale"_a,
           "rows"_a)
      .def("evaluate", &evaluate, "q"_a,
           "Run the kinematics and evaluate the terms, but for the foreign ones.")
      .def("assemble", [](BoundEngine& bound, double dt) { return (*bound).assemble(dt); }, "dt"_a,
           "Write the program at what was evaluated; return whether a joint is outside its range.")
      .def("follow", &BoundEngine::follow, "kinematics"_a,
           "Place what a step looks at by these, in place of MuJoCo's.")
      .def("limit", &BoundEngine::limit, "rows"_a, "shortening"_a.none(),
           "Have rows in the program, and commands checked where they lead.")
      .def("solve", &solve, "q"_a.none(), "dt"_a, "seconds"_a, "solution"_a.noconvert(),
           "Solve a step at q, or at what was evaluated if it is None; write v and z, and return how\n"
           "it ended, the iterations, the residuals, whether a joint or a distance is outside its\n"
           "limit, what is left of the command, and whether rows were relaxed.")
      .def_prop_ro(
          "moved",
          [](BoundEngine& bound) -> std::optional<std::tuple<Numbers, Numbers, Numbers>> {
            const Engine& engine = *bound;
            if (!engine.moved()) return std::nullopt;
            const int rows = engine.row_count(), equalities = engine.equality_count();
            return std::tuple(Numbers(engine.lower(), engine.lower() + rows),
                              Numbers(engine.upper(), engine.upper() + rows),
                              Numbers(engine.right(), engine.right() + equalities));
          },
          "The lo, hi and f that the last step was solved with in the end; None if they were those\n"
          "of rows and equalities.")
      .def_prop_ro("boxed", [](BoundEngine& bound) { return (*bound).boxed(); },
                   "Whether the last step left rows and equalities out in the end.")
      .def("forget", [](BoundEngine& bound) { (*bound).forget(); }, "Start the next solve cold.");
}

}  // namespace rmrc
