#include "limits/slides.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace rmrc {

Slides::Slides(std::vector<Slide> slides, const double* twist)
    : slides_(std::move(slides)), twist_(twist), beyond_(slides_.size()) {}

void Slides::begin(const double* q, const double* travel) {
  any_ = false;
  for (std::size_t k = 0; k < slides_.size(); ++k) {
    const Slide& slide = slides_[k];
    const double out = std::abs(q[slide.coordinate] - slide.zero) + travel[slide.dof];
    beyond_[k] = std::max(out - slide.counted, 0.0);
    any_ |= beyond_[k] != 0.0;
  }
}

void Slides::stretch(double* step, double dt) const {
  if (!any_) return;
  for (std::size_t k = 0; k < slides_.size(); ++k) {
    const Slide& slide = slides_[k];
    double turn = 0.0;
    for (const int dof : slide.before) turn += step[dof];
    for (int i = 3; slide.mocap >= 0 && i < 6; ++i) {
      turn += std::abs(twist_[6 * slide.mocap + i]) * dt;
    }
    step[slide.dof] += turn * beyond_[k];
  }
}

}  // namespace rmrc
