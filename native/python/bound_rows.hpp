// The rows of a step in Python: built from the arrays of its barriers, whose state they share.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "limits/rows.hpp"
#include "python/bindings.hpp"

namespace rmrc {

using Integers = nanobind::ndarray<std::int64_t, nanobind::c_contig, nanobind::device::cpu>;

/// Arrays by their names, each looked at for its type and its size.
class Fields {
 public:
  explicit Fields(nanobind::dict fields) : fields_(std::move(fields)) {}

  double* doubles(const char* name, std::size_t size) const { return get<double>(name, size); }
  std::int64_t* integers(const char* name, std::size_t size) const {
    return get<std::int64_t>(name, size);
  }
  std::uint8_t* flags(const char* name, std::size_t size) const {
    return reinterpret_cast<std::uint8_t*>(get<bool>(name, size));
  }
  std::size_t size(const char* name) const {
    return nanobind::cast<nanobind::ndarray<nanobind::ro, nanobind::device::cpu>>(fields_[name]).size();
  }

 private:
  template <class Number>
  Number* get(const char* name, std::size_t size) const {
    const auto array =
        nanobind::cast<nanobind::ndarray<Number, nanobind::c_contig, nanobind::device::cpu>>(fields_[name], false);
    if (array.size() != size) throw std::invalid_argument(std::string(name) + " has a wrong size");
    return array.data();
  }

  nanobind::dict fields_;
};

/// How many of each thing the arrays of kinematics are of.
struct Counts {
  std::size_t coordinates, mocaps, bodies, geoms, sites, dofs;
  bool operator==(const Counts&) const = default;
};

/// The arrays of an mjData, which live as long.
struct BoundKinematics {
  Kinematics arrays;
  Counts counts;
  nanobind::object data, kept;
};

/// The rows, and the arrays of Python's that they point into.
class BoundRows {
 public:
  using TendonArgument =
      std::tuple<double, double, std::vector<int>, std::vector<int>, std::vector<double>>;

  BoundRows(nanobind::handle engine, const BoundKinematics& now, Writing matrix, Writing lower, Writing upper, Writing multiplier, Integers ids,
            Writing distance, Writing slope, Writing drift);

  Rows& operator*() { return *rows_; }
  const Counts& counts() const { return counts_; }

  /// Have nothing added any more.
  void close() { closed_ = true; }

  void know(double resolution, std::vector<bool> turning,
            const std::vector<std::tuple<int, int, double, double, int, std::vector<int>>>& slides,
            Reading twist);
  void add_speed(Reading position, Reading rotation, Reading reference, std::vector<int> dofs,
                 bool turned, double linear, double angular, Reading rate);
  void add_collision(double d_min, double detect, double gain, double push, Reading twist,
                     const nanobind::dict& arrays);
  void add_workspace(
      const std::vector<std::tuple<std::string, int, int, int, Numbers, double, std::vector<int>,
                                   Numbers>>& planes,
      double gain, double push, Reading twist);
  void add_balls(const std::vector<std::tuple<int, int, double>>& balls, double gain,
                 double push);
  void add_tendons(const std::vector<TendonArgument>& ends, double gain, double push);
  std::vector<std::tuple<int, int>> kept_blocks() const {
    std::vector<std::tuple<int, int>> found;
    for (const Block& block : rows_->kept_blocks()) found.emplace_back(block.first, block.count);
    return found;
  }

  std::vector<std::tuple<int, int>> blocks() const {
    std::vector<std::tuple<int, int>> found;
    for (const Block& block : rows_->blocks()) found.emplace_back(block.first, block.count);
    return found;
  }

 private:
  // Who checks commands by the barriers has looked which there are.
  void require_open() const {
    if (closed_) throw std::invalid_argument("these rows are in use: nothing can be added");
  }

  void require_twists(const Reading& twist) const {
    require(twist, 6 * counts_.mocaps, "twist");
  }

  std::vector<nanobind::object> kept_;
  const double* v_previous_ = nullptr;  // of the engine's stack
  Counts counts_;
  bool closed_ = false;
  std::unique_ptr<Rows> rows_;
};

/// Add the check of a command where it leads.
void bind_shortening(nanobind::module_& m);

}  // namespace rmrc
