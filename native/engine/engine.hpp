// The whole step: evaluate, assemble, solve, certify, and what there is where that fails.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "base/clock.hpp"
#include "base/memory.hpp"
#include "base/numbers.hpp"
#include "engine/braking.hpp"
#include "engine/correction.hpp"
#include "engine/shorten.hpp"
#include "kinematics/kinematics.hpp"
#include "kinematics/mujoco.hpp"
#include "limits/box.hpp"
#include "limits/rows.hpp"
#include "solver/certificate.hpp"
#include "solver/cholesky.hpp"
#include "solver/least_violation.hpp"
#include "solver/qp.hpp"
#include "tasks/damping.hpp"
#include "tasks/equalities.hpp"
#include "tasks/foreign_rows.hpp"
#include "tasks/joint_term.hpp"
#include "tasks/levels.hpp"
#include "tasks/row_term.hpp"

namespace rmrc {

/// The program's own arrays, which Python reads as well.
struct ProgramArrays {
  double* H;  // (n, n)
  double* g;
  double* lb;
  double* ub;
  double* rate;              // ẋ = K clamp(e) + ẋ_ff of all terms
  double* added_damping;     // λ_a²
  double* inertia;           // M(q) (nv, nv), where A has a share of it
  const double* a_previous;  // (nv,)
};

/// What no configuration changes.
struct Constants {
  std::vector<int> dofs;         // (n,)
  std::vector<double> hessian;   // A + λ₀²I + Σ B of the terms on the joints (n, n)
  double unit;                   // what the whole cost is multiplied by
  double inertia;                // the share of M(q) in A
  double floor;                  // λ₀²
  double least_curvature;        // the least dt K in X
  bool brakes;                   // whether what drives the errors brakes in time
  double soft_ratio;             // of the weights of a level and the one above it
};

/// Solves one step after the other, each from the active set of the last.
///
/// The specification is rmrc.engine.python.PythonEngine. All memory is taken before the first step.
class Engine {
 public:
  Engine(const MuJoCo& mujoco, const Stack& stack, const ProgramArrays& program,
         Constants constants, JointLimits limits, int max_iterations);
  Engine(const Engine&) = delete;
  Engine& operator=(const Engine&) = delete;

  const MuJoCo& mujoco() const { return mujoco_; }
  const Stack& stack() const { return stack_; }

  /// Add a term; throws std::invalid_argument if it reads what the kinematics do not place.
  void add(std::unique_ptr<RowTerm> term);
  void add(std::unique_ptr<ForeignRows> term);
  void add(JointTerm term) { joints_.push_back(std::move(term)); }
  void adapt(DampingRule rule, std::vector<TaskedRow> rows);

  /// Have rows in the program, and commands checked where they lead: both must live as long.
  void limit(Rows& limits, Shortening* shortening);

  /// Place what a step looks at by these in place of MuJoCo's, where nothing else is to be known:
  /// they must live as long. Throws std::invalid_argument if terms or rows read more than that.
  void follow(ForwardKinematics& kinematics);

  /// Have what the hard tasks ask for in the program.
  void hold(std::unique_ptr<Equalities> equalities);

  /// Solve levels one after another, in place of one program; after all terms, rows and hard tasks.
  void descend(std::vector<LevelTasks> levels, LastMetric metric);

  /// Run the kinematics of the whole model at q (nq,) and evaluate the terms, but for those that
  /// others evaluate.
  void evaluate(const double* q);

  /// Write the program at what was evaluated, for a step of dt seconds; return whether a joint is
  /// outside its range.
  bool assemble(double dt);

  /// Solve a step of dt seconds at q (nq,), or at what was evaluated last if q is null, within so
  /// many seconds from now.
  SolveStatus solve(const double* q, double dt,
               double seconds = infinity);

  /// Forget the last solution, so that the next solve starts cold.
  void forget();

  /// Forget what the rows know of the steps before that is more than where things are.
  void forget_rows() {
    if (limits_ != nullptr) limits_->forget();
  }

  /// Go through what there is to keep between two solves, if others come between them.
  void keep(Memory& memory);

  /// Have no feed-forward for targets that do not move, whatever others did before.
  void rest_targets();

  const JointLimits& joint_limits() const { return box_.limits(); }

  int size() const { return static_cast<int>(constants_.dofs.size()); }
  const std::vector<int>& dofs() const { return constants_.dofs; }
  const double* v() const { return v_.data(); }
  const double* bound_multiplier() const { return z_.data(); }
  const Residuals& residuals() const { return residuals_; }
  int iterations() const { return iterations_; }
  const std::vector<std::unique_ptr<RowTerm>>& row_terms() const { return rows_; }
  const double* rate() const { return program_.rate; }

  /// Whether a joint or a distance was outside its limit at the last step.
  bool outside() const { return outside_ || (limits_ != nullptr && limits_->passed()); }

  /// Whether a task that preserves its direction ran slower than asked at the last step.
  bool scaled() const;

  /// Whether the levels are solved one after another.
  bool cascaded() const { return cascade_ != nullptr; }

  /// What the check where it leads has left of the last command, from the brake on.
  double share() const { return share_; }

  /// Whether rows or equalities could not hold, and what is solved is a compromise; or a distance
  /// falls below its limit even so, or a shortened command misses what is no distance.
  bool relaxed() const {
    return relaxed_ || (equalities_ != nullptr && equalities_->inconsistent());
  }

  /// Whether the last step's program had other limits than rows and equalities ask for, raised or
  /// relaxed: `lower`, `upper` and `right`.
  bool moved() const { return moved_; }
  const double* lower() const { return lower_.data(); }
  const double* upper() const { return upper_.data(); }
  const double* right() const { return right_.data(); }

  /// Whether rows and equalities were left out in the end.
  bool boxed() const { return boxed_; }

  /// How many rows and equalities the last step had.
  int row_count() const;
  int equality_count() const;

  /// The rows of the last step; null if the problem has none.
  const Rows* limits() const { return limits_; }

  /// The equalities of the last step; null if the problem has none.
  const Equalities* equalities() const { return equalities_.get(); }

  /// Whether λ_a² of the last step was more than rounding.
  bool damped() const;

  /// Whether the present step's time is not over.
  bool in_time() const { return !is_over(end_); }

 private:
  void require_placed(const Poses& poses) const;
  void place(const double* q);
  void place_all(const double* q);
  void evaluate_terms();
  void rates(double dt);
  void rate_of(const TermData& term, double dt);
  void add_terms();
  void add_curvature();
  void brake_in_time();

  bool is_still() const;
  void update_equalities();
  bool cannot_hold();
  template <class Which>
  bool passes(const double* v, Which which);
  template <class Which>
  bool is_weak(const double* v, Which which);
  bool turns_back();
  void soften();
  double missed_softly();
  void spare(const std::vector<Level>& levels);
  void add_joints();
  void add_inertia();
  SolveStatus attempt();
  Program program() const;
  SolveStatus best();
  SolveStatus certified_best();
  SolveStatus solve_levels();
  bool trusted(SolveStatus ending) const;
  void renew_solver();
  void brake(double* v);
  void plan();

  SolveStatus descend_ladder(SolveStatus ending, bool warm);
  bool feasible(SolveStatus ending) const;
  bool relax();
  SolveStatus within_relaxed();
  SolveStatus without_rows();
  SolveStatus stop(SolveStatus ending);

  bool cut();
  void slow_down();
  void at_distance(double dt);
  void keep_distances(double dt);
  bool misses() const;
  bool is_forced() const;
  void move_limits();

  // What becomes of a program that is solved, but for the vectors.
  struct Outcome {
    Residuals residuals;
    int iterations;
    double share;
    bool relaxed;
  };

  MuJoCo mujoco_;
  Stack stack_;
  ProgramArrays program_;
  Constants constants_;
  Box box_;
  Braking braking_;
  std::vector<std::unique_ptr<RowTerm>> rows_;
  std::vector<ForeignRows*> foreign_;  // those among them that others evaluate
  std::vector<JointTerm> joints_;
  std::optional<Damping> damping_;
  Rows* limits_ = nullptr;
  Shortening* shortening_ = nullptr;
  ForwardKinematics* kinematics_ = nullptr;
  std::optional<Correction> correction_;
  std::optional<LeastViolation> least_;
  bool moved_ = false, boxed_ = false, relaxed_ = false;
  bool softened_ = false;  // whether hard tasks that bend are a cost at this step
  bool cuts_ = false;      // whether planes may be added, as nothing of the program was relaxed
  bool bent_ = false;      // whether H has the curvature of speeds
  std::vector<double> plain_;  // H without it (n, n)
  double share_ = 1.0;
  std::vector<double> lower_, upper_, right_;  // what limits were moved to
  std::vector<double> whole_, brake_, shortened_, first_z_, first_y_, first_w_;
  std::unique_ptr<Equalities> equalities_;
  std::unique_ptr<Levels> levels_;
  std::unique_ptr<Cascade> cascade_;
  int max_iterations_;
  QPSolver solver_;
  bool warm_ = false;
  Clock::time_point end_;
  double dt_ = 0.0;
  bool outside_ = false;
  int iterations_ = 0;
  Residuals residuals_{};
  std::vector<double> v_, z_, residual_;
  std::vector<double> gradient_;  // (nv,)
  std::vector<double> curvature_;  // X of one program (n,)
  std::vector<double> exact_;      // a row of a hard task, or the shortest v that holds them (n,)
  std::vector<double> missed_, gram_;  // of what a level cannot get (rows,), (rows, rows)
  std::vector<int> all_rows_;      // 0, 1, 2 …
  std::optional<Cholesky> gram_factor_;
  std::vector<double> unfed_;      // ẋ of a term without its feed-forward (nv,)
  std::vector<double> v_previous_, a_previous_;  // of the dofs (n,)
  std::vector<double> planned_;  // what braking leaves of the velocity (n,)
  std::vector<double> least_norm_;  // least v that holds E v = f (n,)
};

}  // namespace rmrc
