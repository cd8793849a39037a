// Hard tasks and levels in Python: handed to an engine, in arrays that stay Python's.

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <memory>
#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

#include "engine/engine.hpp"
#include "python/bindings.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace rmrc {

namespace {

// The place and length of a task, its directions, whether J is the identity, and its axis.
using HardArgument = std::tuple<int, int, Numbers, bool, Numbers>;

void hold(nb::handle engine, const std::vector<HardArgument>& tasks, const std::vector<bool>& still,
          const Writing& matrix, const Writing& right, const Writing& multiplier) {
  Engine& native = engine_of(engine);
  require_no_levels(native);
  const auto n = static_cast<std::size_t>(native.size());
  const int nv = native.mujoco().nv;
  std::vector<HardTerm> terms;
  std::size_t all = 0;
  for (const auto& [first, rows, directions, joint, axis] : tasks) {
    require_part(first, rows, joint ? native.stack().errors : native.stack().rows, "row");
    if (rows == 0 || directions.size() % rows != 0 || (joint && rows != nv) ||
        (!axis.empty() && (axis.size() != 3 || rows < 3))) {
      throw std::invalid_argument("a hard task has a wrong size");
    }
    all += directions.size() / rows;
    const auto bends = [&](const auto& term) {
      return term->exact() && term->data().first == first;
    };
    const auto& all_rows = native.row_terms();
    const bool bending = !joint && std::any_of(all_rows.begin(), all_rows.end(), bends);
    terms.push_back({first, rows, directions, joint, axis, bending});
  }
  require_countable(static_cast<std::int64_t>(all), native.mujoco().nv);
  if (still.size() != n || matrix.size() != all * n || right.size() != all ||
      multiplier.size() != all) {
    throw std::invalid_argument("the equalities have a wrong size");
  }
  native.hold(std::make_unique<Equalities>(
      native.stack(), native.rate(), native.mujoco().nv, native.dofs(),
      std::vector<char>(still.begin(), still.end()), std::move(terms),
      EqualityArrays{matrix.data(), right.data(), multiplier.data()}));
}

// Of each level: the place of each term with rows and those that keep their direction; the place and
// the root of each term on the joints.
using LevelArgument = std::tuple<std::vector<std::tuple<int, std::vector<int>>>,
                                 std::vector<std::tuple<int, Numbers>>>;

void descend(nb::handle engine, const std::vector<LevelArgument>& levels, Numbers metric,
             double inertia) {
  Engine& native = engine_of(engine);
  const auto& terms = native.row_terms();
  const auto n = static_cast<std::size_t>(native.size());
  const auto nv = static_cast<std::size_t>(native.mujoco().nv);
  if (metric.size() != n * n) throw std::invalid_argument("the metric has a wrong size");
  std::vector<LevelTasks> made;
  for (const auto& [parts, joints] : levels) {
    LevelTasks& level = made.emplace_back();
    for (const auto& [term, directed] : parts) {
      if (term < 0 || term >= static_cast<int>(terms.size())) {
        throw std::invalid_argument("a level's task is none of the engine's");
      }
      for (const int row : directed) {
        if (row < 0 || row >= terms[term]->data().rows) {
          throw std::invalid_argument("there is no such row");
        }
      }
      level.parts.push_back({term, directed});
    }
    for (const auto& [first, root] : joints) {
      require_part(first, static_cast<std::int64_t>(nv), native.stack().errors, "row");
      if (root.size() % nv != 0) throw std::invalid_argument("a root has a wrong size");
      level.joints.push_back({first, root});
    }
  }
  native.descend(std::move(made), {std::move(metric), inertia});
}

}  // namespace

void bind_levels(nb::module_& m) {
  m.def("hold", &hold, "engine"_a, "tasks"_a, "still"_a, "matrix"_a.noconvert(),
        "right"_a.noconvert(), "multiplier"_a.noconvert(),
        nb::keep_alive<1, 4>(), nb::keep_alive<1, 5>(), nb::keep_alive<1, 6>(),
        "Have hard tasks in the program of an engine, whose E, f and w stand in these arrays.");
  m.def("equalities", [](nb::handle engine) {
    const Engine& native = engine_of(engine);
    return native.equalities() == nullptr ? 0 : native.equalities()->count();
  }, "engine"_a, "Return the number of equalities of the last step.");
  m.def("descend", &descend, "engine"_a, "levels"_a, "metric"_a, "inertia"_a,
        "Have levels solved one after another, in place of one program.");
  m.def("scaled", [](nb::handle engine) { return engine_of(engine).scaled(); }, "engine"_a,
        "Return whether a task that preserves its direction ran slower than asked.");
}

}  // namespace rmrc
