// The Python module rmrc._native.

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstdint>
#include <stdexcept>

#include "base/numbers.hpp"
#include "python/bindings.hpp"
#include "solver/qp.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Matrix = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Vector = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Result = nb::ndarray<nb::numpy, double, nb::ndim<1>>;

/// Return an array of its own with a copy of n elements.
Result copied(const double* values, int n) {
  auto* data = new double[static_cast<std::size_t>(n)];
  std::copy_n(values, n, data);
  const nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<double*>(p); });
  return Result(data, {static_cast<std::size_t>(n)}, owner);
}

rmrc::QPSolver make_solver(int size, int rows, int equalities, int max_iter) {
  if (size < 1 || max_iter < 1) throw std::invalid_argument("a size is out of range");
  const auto all = static_cast<std::int64_t>(rows) + equalities;
  rmrc::require_countable(std::max<std::int64_t>({rows, equalities, all, size + std::int64_t{4}}),
                          size + std::int64_t{4});
  if (rows < 0 || equalities < 0) throw std::invalid_argument("a size is out of range");
  return rmrc::QPSolver(size, rows, equalities, max_iter);
}

nb::tuple solve(rmrc::QPSolver& solver, const Matrix& H, const Vector& g, const Vector& lb,
                const Vector& ub, const Matrix& C, const Vector& lo, const Vector& hi,
                const Matrix& E, const Vector& f, double seconds) {
  const auto n = static_cast<std::size_t>(solver.size());
  const std::size_t rows = lo.shape(0), equalities = f.shape(0);
  if (H.shape(0) != n || H.shape(1) != n || g.shape(0) != n || lb.shape(0) != n ||
      ub.shape(0) != n || C.shape(0) != rows || C.shape(1) != n || hi.shape(0) != rows ||
      E.shape(0) != equalities || E.shape(1) != n) {
    throw std::invalid_argument("the shapes of the program's arrays do not fit each other");
  }
  if (rows > static_cast<std::size_t>(solver.max_rows()) ||
      equalities > static_cast<std::size_t>(solver.max_equalities())) {
    throw std::invalid_argument("the program has more rows than the solver has room for");
  }
  const rmrc::Program program{H.data(),  g.data(),  lb.data(),
                              ub.data(), C.data(),  lo.data(),
                              hi.data(), E.data(),  f.data(),
                              static_cast<int>(rows), static_cast<int>(equalities)};
  const rmrc::SolveStatus status = solver.solve(program, rmrc::end_after(seconds));
  return nb::make_tuple(copied(solver.v(), solver.size()),
                        copied(solver.bound_multiplier(), solver.size()),
                        copied(solver.row_multiplier(), program.rows),
                        copied(solver.equality_multiplier(), program.equalities),
                        solver.iterations(), rmrc::name_of(status));
}

// Whether this machine has the instructions that the solver is compiled to.
bool runs_here() {
#ifdef RMRC_AVX2
  return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
#else
  return true;
#endif
}

}  // namespace

NB_MODULE(_native, m) {
  if (!runs_here()) throw nb::import_error("rmrc._native needs a processor with AVX2 and FMA");
  m.doc() = "What rmrc does in C++.";
  nb::class_<rmrc::QPSolver>(
      m, "QPSolver", "A dual active-set solver of quadratic programs, which starts warm.")
      .def(nb::new_(&make_solver), "size"_a, "rows"_a = 0, "equalities"_a = 0, "max_iter"_a = 1000,
           "Allocate for programs of `size` variables and up to so many rows and equalities.\n\n"
           "Raises ValueError for a size out of range.")
      .def("solve", &solve, "H"_a, "g"_a, "lb"_a, "ub"_a, "C"_a, "lo"_a, "hi"_a, "E"_a, "f"_a,
           "seconds"_a = rmrc::infinity,
           "Return v, z, y, w, the changes of the active set, and the name of the status.\n\n"
           "The program is that of `rmrc.qp.program.QP`, the multipliers those of `Solution`.\n"
           "After so many seconds it is cut off.\n"
           "Raises ValueError where shapes do not fit.")
      .def("forget", &rmrc::QPSolver::forget, "Start the next solve cold.")
      .def_prop_ro("shape", [](const rmrc::QPSolver& solver) {
        return nb::make_tuple(solver.size(), solver.max_rows(), solver.max_equalities());
      }, "The number of variables, and the most rows and equalities.");
  rmrc::bind_kinematics(m);
  rmrc::bind_engine(m);
  rmrc::bind_levels(m);
  rmrc::bind_rows(m);
  rmrc::bind_stepper(m);
  rmrc::bind_record(m);
  rmrc::bind_loop(m);
  rmrc::bind_batch(m);
}
