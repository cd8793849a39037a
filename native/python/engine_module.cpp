// The engine in Python, but for its terms.

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

#include "python/bound_engine.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace rmrc {

namespace {

template <class Function>
Function function(std::uintptr_t address) {
  if (address == 0) throw std::invalid_argument("a function of MuJoCo's is missing");
  return reinterpret_cast<Function>(address);
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
  const SolveStatus ending = engine.solve(q ? q->data() : nullptr, dt, seconds);
  std::copy_n(engine.v(), n, solution.data());
  std::copy_n(engine.bound_multiplier(), n, solution.data() + n);
  const Residuals& kkt = engine.residuals();
  return nb::make_tuple(name_of(ending), engine.iterations(), kkt.primal, kkt.dual,
                        kkt.complementarity, engine.outside(), engine.share(), engine.relaxed());
}

// Return which parts of a model a joint or a mocap body moves.
MovingParts moving_parts(nb::handle model) {
  const auto integers = [&](const char* name) {
    return nb::cast<std::vector<int>>(model.attr(name).attr("tolist")());
  };
  const std::vector<int> parents = integers("body_parentid"), joints = integers("body_jntnum"),
                         mocap = integers("body_mocapid");
  MovingParts moving;
  for (std::size_t k = 0; k < parents.size(); ++k) {  // a parent comes before its children
    const bool own = joints[k] > 0 || mocap[k] >= 0;
    moving.bodies.push_back(static_cast<char>(k > 0 && (own || moving.bodies[parents[k]] != 0)));
  }
  for (const int body : integers("geom_bodyid")) moving.geoms.push_back(moving.bodies[body]);
  for (const int body : integers("site_bodyid")) moving.sites.push_back(moving.bodies[body]);
  return moving;
}

}  // namespace

BoundEngine::BoundEngine(const std::vector<std::uintptr_t>& functions, nb::object model, nb::object data,
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
      cdof.data(),
      std::make_shared<const MovingParts>(moving_parts(model))};
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

void BoundEngine::limit(nb::object rows, nb::object shortening) {
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

void BoundEngine::follow(nb::object kinematics) {
  ForwardKinematics& native = kinematics_of(kinematics);
  if (native.coordinates() != engine_->mujoco().nq) {
    throw std::invalid_argument("the kinematics are another model's");
  }
  engine_->follow(native);
  kept_.push_back(std::move(kinematics));
}

void BoundEngine::adapt(const std::string& rule, double threshold, double largest, int rank, double scale,
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
  bind_terms(m);
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
