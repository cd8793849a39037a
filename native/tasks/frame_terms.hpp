// `frame` tasks, along the axes of the body or of the world.
#pragma once

#include <vector>

#include "tasks/row_term.hpp"

namespace rmrc {

/// e = log(T_bt) and J = Jl⁻¹(e) J_b: a `frame` task along the body's axes.
class BodyFrame final : public RowTerm {
 public:
  BodyFrame(TermData data, std::vector<double> root, Frame frame, const MuJoCo& mujoco,
            const Stack& stack);
  void measure(double* measures) const override;

 private:
  void differentiate() override;
  Frame frame_;
};

/// e = [p_t − p_b; log(R_t R_bᵀ)]: a `frame` task along the world's axes.
class WorldFrame final : public RowTerm {
 public:
  WorldFrame(TermData data, std::vector<double> root, Frame frame, const MuJoCo& mujoco,
             const Stack& stack);
  void measure(double* measures) const override;

 private:
  void differentiate() override;
  Frame frame_;
};

}  // namespace rmrc
