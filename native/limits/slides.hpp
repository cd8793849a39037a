// How much more than their levers say turning slides can move what they carry.
#pragma once

#include <vector>

namespace rmrc {

/// A slide that other joints turn.
struct Slide {
  int coordinate, dof;
  double zero, counted;     // its way from zero that levers count
  int mocap;                // the mocap body that its robot stands on, or −1
  std::vector<int> before;  // the dofs that turn it
};

/// The slides of a robot: rmrc.limits.slides.Slides.
class Slides {
 public:
  Slides() = default;

  /// `twist` are the velocities of the mocap bodies (nmocap, 6).
  Slides(std::vector<Slide> slides, const double* twist);

  /// Note how far the slides are beyond what levers count at q (nq,), or may come by a travel (nv,).
  void begin(const double* q, const double* travel);

  /// Add to a step |Δq| (nv,) of dt, or to rates of it, what levers leave out.
  void stretch(double* step, double dt) const;

 private:
  std::vector<Slide> slides_;
  const double* twist_ = nullptr;
  std::vector<double> beyond_;
  bool any_ = false;
};

}  // namespace rmrc
