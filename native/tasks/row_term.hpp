// The terms of the cost: errors, Jacobians and feed-forwards, as rmrc.tasks defines them.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "base/numbers.hpp"
#include "kinematics/frame.hpp"
#include "kinematics/mujoco.hpp"

namespace rmrc {

/// What the terms of a problem write into and read from, arrays of Python's.
struct Stack {
  double* error;        // e of all terms
  double* feedforward;  // ẋ_ff of all terms
  double* jacobian;     // J of the terms with rows (row_count, nv)
  const double* v_previous;  // (nv,)
  const int* place;          // column of each dof in the program (nv,); −1 where it stands still
  int errors = 0, rows = 0;  // how long e is, and how many rows J has
};

/// A part of an error that acts on its task only up to a length.
struct Clamp {
  int first, count;
  double longest;
};

/// What all terms have.
struct TermData {
  int first, rows;             // where the term's error stands, and its length
  double gain;                 // K, 1/s
  const double* target;
  const double* twist;         // the target's own velocity (6,)
  const std::uint8_t* moving;  // whether it has one
  std::vector<Clamp> clamps;
};

/// A dof on the way from the world to what a term draws.
struct WayJoint {
  int dof;
  int before;   // the place in the way of the one right before it, −1 for none
  bool turns;   // whether it is a hinge
  double unit;  // 1, or the length that a slide's rate is measured in
};

/// A term with a Jacobian of its own, over the columns of the dofs that move it.
class RowTerm {
 public:
  /// `root` is S with B = SᵀS: (rows,) a diagonal or (rows, rows); `reads` is all that e and J come
  /// from.
  RowTerm(TermData data, std::vector<double> root, Reads reads, const MuJoCo& mujoco,
          const Stack& stack);
  virtual ~RowTerm() = default;
  RowTerm(const RowTerm&) = delete;
  RowTerm& operator=(const RowTerm&) = delete;

  /// Write e, ẋ_ff and J at the present kinematics, and W = S J.
  virtual void evaluate();

  /// H ← H + WᵀW, its lower triangle, and g ← g − Wᵀ S ẋ, of a program of n variables.
  void add_to(double* H, double* g, int n, const double* rate);

  /// Return element r of S x, for x (rows,).
  double weighed(int r, const double* x) const;

  /// Copy row r of W (n,) into a row of zeros.
  void copy_row(int r, double* row) const;

  /// Return xᵀBx (rows,).
  double weighed_square(const double* x) const;

  /// Return element r of J v, for v of the program (n,).
  double rate_of(int r, const double* v) const;

  /// Tell which dofs of the program the error bends with, in their order; of a term that no cost
  /// draws, with a root of what of its rows counts.
  void bend(const std::vector<WayJoint>& way, std::vector<double> exact_root);

  /// Whether no cost draws the term: J v = ẋ, or along ẋ.
  bool exact() const { return !exact_root_.empty(); }

  /// Return Σ (B ẋ)ᵀ(J v) and add Σ K dt (J v)ᵀB(J v) to `curved`, for v of the program.
  double drawn(const double* rate, const double* v, double dt, double& curved);

  /// Write row r of S J (n,), S the root of what of its rows counts; return element r of S ẋ.
  double exact_row(int r, const double* rate, double* row) const;

  /// Return uᵀCu for a motion u of the program, at x (rows,) of S x: rmrc.qp.curvature.
  double bent(const double* x, const double* u);

  /// X ← X + max(dt K, least) times the row sums of |C| (n,), at ẋ: rmrc.qp.curvature.
  void add_curvature(const double* rate, double dt, double least, double* X);

  /// Write the true errors (2,), the distance and the angle, or one number twice.
  virtual void measure(double* measures) const;

  /// driven ← driven + Wᵀ S x and way ← way + Wᵀ S x / gain (n,), for x = ẋ less its feed-forward.
  void pull(const double* rate, double gain, double* driven, double* way);

  /// Whether the term has a weight.
  bool counts() const { return counts_; }

  /// Whether X has a part of the term's.
  bool bends() const { return !way_.empty() && counts_ && !exact(); }

  /// Whether the term bends and is hard: it has no weight in the cost.
  bool is_hard() const { return exact() && !counts_; }

  /// Whether the term has a way.
  bool has_way() const { return !way_.empty(); }

  /// The poses that are read.
  const Poses& poses() const { return poses_; }

  const TermData& data() const { return data_; }
  const std::vector<double>& root() const { return root_; }

 protected:
  /// Write e, ẋ_ff where the target moves, and J by `turn` or `column`.
  virtual void differentiate() = 0;

  /// J_w ← the frame's Jacobian along the world's axes.
  void move(const Frame& frame);

  /// J_w ← J_w less how a base carries a point along.
  void carry(const Frame& base, const double* point);

  /// J ← T J_w for T (rows, 6).
  void turn(const double* T);

  /// W = S J.
  void weigh();

  double* error() { return stack_.error + data_.first; }
  const double* error() const { return stack_.error + data_.first; }
  double* feedforward() { return stack_.feedforward + data_.first; }
  bool moves() const { return *data_.moving != 0; }

  TermData data_;
  const MuJoCo& mujoco_;
  const Stack& stack_;
  std::vector<int> dofs_;  // of the columns: first those that are in the program
  int stride_;
  std::vector<double> jacobian_;  // (rows, stride), and zeros behind the last column
  std::vector<double> world_;     // J_w (6, stride): how the dofs move the frame
  const bool carried_;             // whether mocap bodies carry any of it, and ẋ_ff has a part of theirs
  std::vector<double> drift_;      // −∂e/∂t (rows,) of the mocap bodies
  double distance_ = infinity;  // of what the pull turns about, m
  double carried_by_[6] = {};      // velocity of what mocap bodies carry of it, as J_w

 private:
  struct WayPoint;
  void add_turning(const double* force, double* X);
  void moment(const WayPoint& point, const double* wrench, double* u) const;

  template <int rows>
  void add_rows(double* H, double* g, int n, int first) const;

  Poses poses_;
  std::vector<double> root_;
  bool counts_;               // whether anything has a weight
  std::vector<int> columns_;  // in the program, in ascending order
  int inside_;                // columns that are in the program
  std::vector<double> weighted_, wanted_;  // W, and S ẋ
  std::vector<double> transform_;          // T (rows, 6)

  struct WayPoint {
    int column;     // of J
    int before;     // in the way, −1 for none
    bool turns;     // whether it is a hinge
    double unit;    // 1, or the length that a slide's rate is measured in
    double hinges;  // before it
    double after;   // Σ ‖u_j‖ at and after it
    double turned[3];  // how fast the dofs up to it turn the frame
  };
  std::vector<WayPoint> way_;
  std::vector<double> exact_root_;
};

}  // namespace rmrc
