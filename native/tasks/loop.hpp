// The `loop` term: equality constraints of the model itself, as rmrc.tasks.loop has them.
#pragma once

#include <vector>

#include "tasks/row_term.hpp"

namespace rmrc {

/// A point and a rotation that a body carries: of an anchor, or of a site.
struct Anchorage {
  Frame frame;               // the body's
  const double* quaternion;  // the body's (4,)
  double point[3];           // in the body's coordinates
  double turn[4];            // wxyz, in the body's coordinates
};

/// A connect, p₁ − p₂ (3 rows), or a weld, with the vector part of its quaternion times the torque
/// scale below it (6 rows).
struct BodyPair {
  int first;  // among the rows of the term
  bool welded;
  double torque_scale;
  Anchorage ends[2];
};

/// y = Σ cᵢqᵢ of a joint, or of a tendon whose length is a sum of joints.
struct Combination {
  struct Part {
    int coordinate, dof;
    double coefficient;
  };
  std::vector<Part> parts;
  double reference;  // y where the residual counts it as 0
};

/// y − y₀ − p(x − x₀) with a polynomial p of degree 4: a constraint of joints or tendons (1 row).
struct Polynomial {
  int first;  // among the rows of the term
  Combination y, x;
  double coefficients[5];
};

/// e = −r(q) and J = ∂r/∂q for MuJoCo's residuals r of connects, welds, joints and fixed tendons.
///
/// As MuJoCo leaves out a constraint that no joint moves, its rows are zero.
class Loop final : public RowTerm {
 public:
  /// `scale` (rows,) turns the residuals into m or rad, of those that are `angular` (rows,).
  Loop(TermData data, std::vector<double> root, std::vector<BodyPair> pairs,
       std::vector<Polynomial> polynomials, std::vector<double> scale, std::vector<char> angular,
       const MuJoCo& mujoco, const Stack& stack);
  void measure(double* measures) const override;

 private:
  void differentiate() override;
  void differentiate(const BodyPair& pair, const char* carries);
  void differentiate(const Polynomial& polynomial);

  std::vector<BodyPair> pairs_;
  std::vector<Polynomial> polynomials_;
  std::vector<double> scale_;
  std::vector<char> angular_;
  // Of each pair, of each column: whether the dof carries the first end (1), the second (2).
  std::vector<char> carries_;
  std::vector<int> column_;  // of each dof among the term's (nv,)
};

}  // namespace rmrc
