#include "tasks/row_term.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "base/kernels.hpp"
#include "base/lie.hpp"
#include "base/numbers.hpp"

namespace rmrc {

RowTerm::RowTerm(TermData data, std::vector<double> root, Reads reads, const MuJoCo& mujoco,
                 const Stack& stack)
    : data_(std::move(data)),
      mujoco_(mujoco),
      stack_(stack),
      dofs_(reads.dofs()),
      carried_(reads.carried()),
      poses_(reads.poses()),
      root_(std::move(root)),
      counts_(std::any_of(root_.begin(), root_.end(), [](double value) { return value != 0.0; })) {
  std::stable_partition(dofs_.begin(), dofs_.end(), [&](int dof) { return stack.place[dof] >= 0; });
  for (const int dof : dofs_) {
    if (stack.place[dof] >= 0) columns_.push_back(stack.place[dof]);
  }
  inside_ = static_cast<int>(columns_.size());
  stride_ = (static_cast<int>(dofs_.size()) + 3) / 4 * 4;
  jacobian_.resize(static_cast<std::size_t>(data_.rows) * stride_);
  weighted_.resize(jacobian_.size());
  wanted_.resize(data_.rows);
  drift_.resize(data_.rows);
  world_.resize(6 * static_cast<std::size_t>(stride_));
  transform_.resize(6 * static_cast<std::size_t>(data_.rows));
}

void RowTerm::evaluate() {
  if (carried_) {
    std::fill(drift_.begin(), drift_.end(), 0.0);
    if (!moves()) std::fill_n(feedforward(), data_.rows, 0.0);
  }
  differentiate();
  if (carried_) {
    for (int r = 0; r < data_.rows; ++r) feedforward()[r] -= drift_[r];
  }
  const int rows = data_.rows, count = static_cast<int>(dofs_.size());
  for (int r = 0; r < rows; ++r) {
    double* out = stack_.jacobian + (data_.first + r) * mujoco_.nv;
    const double* own = jacobian_.data() + r * stride_;
    for (int k = 0; k < count; ++k) out[dofs_[k]] = own[k];
  }
  weigh();
}

void RowTerm::weigh() {
  const int rows = data_.rows;
  const bool full = static_cast<int>(root_.size()) > rows;
  for (int r = 0; r < rows; ++r) {
    double* out = weighted_.data() + r * stride_;
    if (!full) {
      const double* own = jacobian_.data() + r * stride_;
      for (int k = 0; k < stride_; k += 4) store(root_[r] * load(own + k), out + k);
      continue;
    }
    std::fill_n(out, stride_, 0.0);
    for (int s = 0; s < rows; ++s) {
      add_scaled(root_[r * rows + s], jacobian_.data() + s * stride_, out, stride_);
    }
  }
}

// Return element r of S x.
double RowTerm::weighed(int r, const double* x) const {
  const int rows = data_.rows;
  return static_cast<int>(root_.size()) > rows ? dot(root_.data() + r * rows, x, rows)
                                               : root_[r] * x[r];
}

double RowTerm::weighed_square(const double* x) const {
  double sum = 0.0;
  for (int r = 0; r < data_.rows; ++r) {
    const double value = weighed(r, x);
    sum += value * value;
  }
  return sum;
}

void RowTerm::add_to(double* H, double* g, int n, const double* rate) {
  if (!counts_) return;
  for (int r = 0; r < data_.rows; ++r) wanted_[r] = weighed(r, rate + data_.first);
  int r = 0;
  for (; r + 6 <= data_.rows; r += 6) add_rows<6>(H, g, n, r);
  for (; r + 3 <= data_.rows; r += 3) add_rows<3>(H, g, n, r);
  for (; r < data_.rows; ++r) add_rows<1>(H, g, n, r);
}

template <int rows>
void RowTerm::add_rows(double* H, double* g, int n, int first) const {
  const double *W = weighted_.data() + first * stride_, *wanted = wanted_.data() + first;
  for (int i = 0; i < inside_; ++i) {
    double own[rows], pull = 0.0;
    for (int r = 0; r < rows; ++r) {
      own[r] = W[r * stride_ + i];
      pull += own[r] * wanted[r];
    }
    g[columns_[i]] -= pull;
    double* row = H + columns_[i] * n;
    for (int k = 0; k <= i; k += 4) {
      Quad sums = own[0] * load(W + k);
      for (int r = 1; r < rows; ++r) sums += own[r] * load(W + r * stride_ + k);
      if (k + 3 <= i && columns_[k + 3] == columns_[k] + 3) {
        double* at = row + columns_[k];
        store(load(at) + sums, at);
        continue;
      }
      for (int l = k; l <= std::min(k + 3, i); ++l) row[columns_[l]] += sums[l - k];
    }
  }
}

void RowTerm::pull(const double* rate, double gain, double* driven, double* way) {
  const int rows = data_.rows;
  const double* fed = stack_.feedforward + data_.first;
  for (int r = 0; r < rows; ++r) wanted_[r] = rate[data_.first + r] - fed[r];
  for (int r = 0; r < rows; ++r) {
    const double x = weighed(r, wanted_.data());
    for (int k = 0; k < inside_; ++k) {
      const double pulled = weighted_[r * stride_ + k] * x;
      driven[columns_[k]] += pulled;
      way[columns_[k]] += pulled / gain;
    }
  }
}

void RowTerm::copy_row(int r, double* row) const {
  for (int k = 0; k < inside_; ++k) row[columns_[k]] = weighted_[r * stride_ + k];
}

double RowTerm::rate_of(int r, const double* v) const {
  double sum = 0.0;
  for (int k = 0; k < inside_; ++k) sum += jacobian_[r * stride_ + k] * v[columns_[k]];
  return sum;
}

void RowTerm::measure(double* measures) const {
  measures[0] = measures[1] = std::sqrt(dot(error(), error(), data_.rows));
}

void RowTerm::move(const Frame& frame) {
  double offset[3];
  for (int i = 0; i < 3; ++i) offset[i] = frame.position[i] - frame.reference[i];
  const int count = static_cast<int>(dofs_.size()), own = static_cast<int>(frame.dofs.size());
  double* world = world_.data();
  if (own < count) std::fill(world_.begin(), world_.end(), 0.0);
  for (int k = 0, found = 0; k < count && found < own; ++k) {
    if (own < count && !std::binary_search(frame.dofs.begin(), frame.dofs.end(), dofs_[k])) {
      continue;
    }
    ++found;
    const double* angular = mujoco_.cdof + 6 * dofs_[k];
    double moved[3];
    cross(angular, offset, moved);
    for (int i = 0; i < 3; ++i) {
      world[i * stride_ + k] = angular[3 + i] + moved[i];
      world[(3 + i) * stride_ + k] = angular[i];
    }
  }
  std::fill_n(carried_by_, 6, 0.0);
  if (frame.carrier == nullptr) return;
  velocity_at(frame.carrier, frame.reference, frame.position, carried_by_);
  std::copy_n(frame.carrier + 3, 3, carried_by_ + 3);
}

void RowTerm::carry(const Frame& base, const double* point) {
  double offset[3];
  for (int i = 0; i < 3; ++i) offset[i] = point[i] - base.reference[i];
  double* world = world_.data();
  for (int k = 0; k < static_cast<int>(dofs_.size()); ++k) {
    if (!std::binary_search(base.dofs.begin(), base.dofs.end(), dofs_[k])) continue;
    const double* angular = mujoco_.cdof + 6 * dofs_[k];
    double moved[3];
    cross(angular, offset, moved);
    for (int i = 0; i < 3; ++i) {
      world[i * stride_ + k] -= angular[3 + i] + moved[i];
      world[(3 + i) * stride_ + k] -= angular[i];
    }
  }
  if (base.carrier == nullptr) return;
  double velocity[3];
  velocity_at(base.carrier, base.reference, point, velocity);
  for (int i = 0; i < 3; ++i) {
    carried_by_[i] -= velocity[i];
    carried_by_[3 + i] -= base.carrier[3 + i];
  }
}

void RowTerm::turn(const double* T) {
  std::copy_n(T, transform_.size(), transform_.begin());
  for (int r = 0; carried_ && r < data_.rows; ++r) drift_[r] += dot(T + 6 * r, carried_by_, 6);
  for (int r = 0; r < data_.rows; ++r, T += 6) {
    double* out = jacobian_.data() + r * stride_;
    for (int k = 0; k < stride_; k += 4) {
      Quad sum = T[0] * load(world_.data() + k);
      for (int i = 1; i < 6; ++i) sum += T[i] * load(world_.data() + i * stride_ + k);
      store(sum, out + k);
    }
  }
}

void RowTerm::bend(const std::vector<WayJoint>& way, std::vector<double> exact_root) {
  exact_root_ = std::move(exact_root);
  for (const WayJoint& joint : way) {
    const auto at = std::find(dofs_.begin(), dofs_.begin() + inside_, joint.dof);
    if (at == dofs_.begin() + inside_) throw std::invalid_argument("a way leaves the program");
    const int before = joint.before;
    const double hinges = before < 0 ? 0.0 : way_[before].hinges + way_[before].turns;
    way_.push_back({static_cast<int>(at - dofs_.begin()), before, joint.turns, joint.unit, hinges,
                    0.0, {}});
  }
  for (int r = 0; r < std::min(data_.rows, 6); ++r) transform_[7 * r] = 1.0;
}

double RowTerm::exact_row(int r, const double* rate, double* row) const {
  const int rows = data_.rows;
  const bool full = static_cast<int>(exact_root_.size()) > rows;
  double wanted = 0.0;
  for (int s = full ? 0 : r; s < (full ? rows : r + 1); ++s) {
    const double weight = exact_root_[full ? r * rows + s : r];
    wanted += weight * rate[data_.first + s];
    const double* own = jacobian_.data() + s * stride_;
    for (int k = 0; k < inside_; ++k) row[columns_[k]] += weight * own[k];
  }
  return wanted;
}

double RowTerm::drawn(const double* rate, const double* v, double dt, double& curved) {
  const int rows = data_.rows;
  const bool full = static_cast<int>(exact_root_.size()) > rows;
  const double gain = std::min(data_.gain, 1.0 / dt);
  double sum = 0.0;
  for (int r = 0; r < rows; ++r) wanted_[r] = rate_of(r, v);
  for (int r = 0; r < rows; ++r) {
    double asked = 0.0, moved = 0.0;
    for (int s = full ? 0 : r; s < (full ? rows : r + 1); ++s) {
      const double weight = exact_root_[full ? r * rows + s : r];
      asked += weight * rate[data_.first + s];
      moved += weight * wanted_[s];
    }
    sum += asked * moved;
    curved += dt * gain * moved * moved;
  }
  return sum;
}

// u_j = v_j × f + ½ ω_j × τ of a wrench [f; τ].
void RowTerm::moment(const WayPoint& point, const double* wrench, double* u) const {
  double v[3], w[3], turned[3];
  for (int i = 0; i < 3; ++i) {
    v[i] = world_[i * stride_ + point.column];
    w[i] = 0.5 * world_[(3 + i) * stride_ + point.column];
  }
  cross(v, wrench, u);
  cross(w, wrench + 3, turned);
  for (int i = 0; i < 3; ++i) u[i] += turned[i];
}

double RowTerm::bent(const double* x, const double* u) {
  if (!(counts_ || exact())) return 0.0;
  const std::vector<double>& root = counts_ ? root_ : exact_root_;
  const int rows = data_.rows;
  const bool full = static_cast<int>(root.size()) > rows;
  double wrench[6] = {}, along[3] = {}, total = 0.0;
  for (int r = 0; r < rows; ++r) {
    for (int s = full ? 0 : r; s < (full ? rows : r + 1); ++s) {
      const double pulled = root[full ? r * rows + s : r] * x[r];
      for (int i = 0; i < 6; ++i) wrench[i] += pulled * transform_[6 * s + i];
    }
  }
  for (WayPoint& point : way_) {
    const double rate = u[columns_[point.column]];
    double turning[3], own_moment[3];
    moment(point, wrench, own_moment);
    for (int i = 0; i < 3; ++i) {
      const double ahead = point.before < 0 ? 0.0 : way_[point.before].turned[i];
      const double own = point.turns ? world_[(3 + i) * stride_ + point.column] * rate : 0.0;
      turning[i] = 2.0 * ahead + own;
      point.turned[i] = ahead + own;
      along[i] += world_[i * stride_ + point.column] * rate;
    }
    total -= rate * dot3(own_moment, turning);
  }
  if (distance_ < infinity) {
    total += norm3(wrench) / distance_ * dot3(along, along);
  }
  return total;
}

void RowTerm::add_curvature(const double* rate, double dt, double least, double* X) {
  if (way_.empty() || !(counts_ || exact())) return;
  const std::vector<double>& root = exact() ? exact_root_ : root_;
  const double time = std::max(dt, least * std::max(1.0 / data_.gain, dt));  // ẋ is K e
  const int rows = data_.rows;
  const bool full = static_cast<int>(root.size()) > rows;
  const double* fed = stack_.feedforward + data_.first;
  double wrench[6] = {}, *unfed = wanted_.data();
  for (int r = 0; r < rows; ++r) unfed[r] = time * (rate[data_.first + r] - fed[r]);
  for (int r = 0; r < rows; ++r) {
    // Element r of S x, and what it adds to Tᵀ Sᵀ S x.
    const double x = full ? dot(root.data() + r * rows, unfed, rows) : root[r] * unfed[r];
    for (int s = full ? 0 : r; s < (full ? rows : r + 1); ++s) {
      const double pulled = root[full ? r * rows + s : r] * x;
      for (int i = 0; i < 6; ++i) wrench[i] += pulled * transform_[6 * s + i];
    }
  }
  for (WayPoint& point : way_) point.after = 0.0;
  for (int k = static_cast<int>(way_.size()) - 1; k >= 0; --k) {
    WayPoint& point = way_[k];
    double u[3];
    moment(point, wrench, u);
    const double length = norm3(u);
    point.after += length * point.unit;
    double& sum = X[columns_[point.column]];
    sum += point.hinges * length / point.unit;
    if (point.turns) sum += point.after;
    if (point.before >= 0) way_[point.before].after += point.after;
  }
  if (distance_ < infinity) add_turning(wrench, X);
}

// ‖v_i‖ ‖v_j‖ ‖f‖/n of a force that turns about a point n away as the frame moves.
void RowTerm::add_turning(const double* force, double* X) {
  const auto lever = [&](int column) {
    double square = 0.0;
    for (int i = 0; i < 3; ++i) {
      const double velocity = world_[i * stride_ + column];
      square += velocity * velocity;
    }
    return std::sqrt(square);
  };
  double sum = 0.0;
  for (const WayPoint& point : way_) sum += lever(point.column);
  const double bend = norm3(force) / distance_ * sum;
  for (const WayPoint& point : way_) X[columns_[point.column]] += bend * lever(point.column);
}

}  // namespace rmrc
