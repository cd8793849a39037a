// The points of pairs of geoms that were nearest before they jumped elsewhere:
// rmrc.limits.contacts.

#include <algorithm>
#include <cmath>

#include "base/lie.hpp"
#include "limits/collision.hpp"

namespace rmrc {

namespace {

constexpr double aside = 0.05;  // rmrc.limits.contacts.ASIDE

}  // namespace

// Write the points of a pair that were nearest before, and are near still.
void Collision::write_contacts(const Kinematics& now, int id, Near& near) const {
  for (int k = 1; k < a_.contact_count[id]; ++k) {
    const double* points = a_.contacts + static_cast<long>(contacts_of_pair) * id + contact * k;
    double segment[6], normal[3], flat[3];
    contact_segment(now, id, points, segment);
    for (int i = 0; i < 3; ++i) normal[i] = segment[3 + i] - segment[i];
    double distance = norm3(normal);
    if (distance == 0.0) continue;
    rotate(now.geom_xmat + 9 * a_.base[id], points + 6, flat);
    const double height = dot3(flat, normal);
    const double slid = std::sqrt(std::max(distance * distance - height * height, 0.0));
    if (height > 0.0 && slid <= aside * distance) {
      std::copy_n(flat, 3, normal);
      distance = height;
    } else {
      for (double& value : normal) value /= distance;
    }
    distance = std::max(distance, a_.distance[id]);
    if (distance < leave * threshold(id)) write(now, id, segment, normal, distance, near);
  }
}

void Collision::forget() { std::fill_n(a_.contact_count, a_.pairs, 0); }

// Take the nearest points of a pair now, and keep those of before where they have jumped.
void Collision::see_contact(const Kinematics& now, int id) {
  double* first = a_.contacts + static_cast<long>(contacts_of_pair) * id;
  int count = static_cast<int>(a_.contact_count[id]);
  double local[contact];
  for (int side = 0; side < 2; ++side) {
    const std::int64_t geom = a_.geoms[2 * id + side];
    double arm[3];
    for (int i = 0; i < 3; ++i) {
      arm[i] = a_.segments[6 * id + 3 * side + i] - now.geom_xpos[3 * geom + i];
    }
    rotate_back(now.geom_xmat + 9 * geom, arm, local + 3 * side);
  }
  rotate_back(now.geom_xmat + 9 * a_.base[id], a_.normals + 3 * id, local + 6);
  if (count > 0 && !is_same(id, local, first)) {
    const int place = contact_place(now, id);
    std::copy_n(first, contact, first + contact * place);
    count = std::max(count, place + 1);
  }
  for (int place = 1; place < count;) {
    if (is_same(id, local, first + contact * place)) {
      --count;
      std::copy_n(first + contact * count, contact, first + contact * place);
    } else {
      ++place;
    }
  }
  std::copy_n(local, contact, first);
  a_.contact_count[id] = std::max(count, 1);
}

// Return where to keep the nearest points of before: for the same, or for the farthest.
int Collision::contact_place(const Kinematics& now, int id) const {
  const double* first = a_.contacts + static_cast<long>(contacts_of_pair) * id;
  const int count = static_cast<int>(a_.contact_count[id]);
  for (int place = 1; place < count; ++place) {
    if (is_same(id, first, first + contact * place)) return place;
  }
  if (count <= most_contacts) return count;
  int farthest_place = 1;
  double most = -1.0;
  for (int place = 1; place < count; ++place) {
    double segment[6], between[3];
    contact_segment(now, id, first + contact * place, segment);
    for (int i = 0; i < 3; ++i) between[i] = segment[3 + i] - segment[i];
    const double square = dot3(between, between);
    if (square <= most) continue;
    most = square;
    farthest_place = place;
  }
  return farthest_place;
}

// Write where kept points are now.
void Collision::contact_segment(const Kinematics& now, int id, const double* points,
                                double* segment) const {
  for (int side = 0; side < 2; ++side) {
    const std::int64_t geom = a_.geoms[2 * id + side];
    rotate(now.geom_xmat + 9 * geom, points + 3 * side, segment + 3 * side);
    for (int i = 0; i < 3; ++i) segment[3 * side + i] += now.geom_xpos[3 * geom + i];
  }
}

// Whether the points of both geoms are no jump away.
bool Collision::is_same(int id, const double* one, const double* other) const {
  double a[3], b[3];
  for (int i = 0; i < 3; ++i) {
    a[i] = one[i] - other[i];
    b[i] = one[3 + i] - other[3 + i];
  }
  return std::max(dot3(a, a), dot3(b, b)) <= a_.apart[id] * a_.apart[id];
}

}  // namespace rmrc
