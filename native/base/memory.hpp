// What a controller keeps from one step to the next, copied out of it and back into it.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <type_traits>
#include <vector>

namespace rmrc {

/// Goes through what is kept, which each class names once in its `keep`: one pass counts the bytes,
/// one stores them, one loads them again. The sizes must be the same in all.
///
/// Large arrays, of which a step touches little, are not copied: `place` has them stand in the
/// memory itself, until they are brought home to where others look for them.
class Memory {
 public:
  /// Count the bytes.
  Memory() = default;

  static Memory storing(std::byte* at) { return Memory(at, Pass::store); }
  static Memory loading(std::byte* at) { return Memory(at, Pass::load); }
  /// Load, and bring home what was placed.
  static Memory returning(std::byte* at) { return Memory(at, Pass::bring_home); }

  std::size_t bytes() const { return bytes_; }

  template <class T>
  void operator()(T* values, std::size_t count) {
    some(values, count, count);
  }

  /// Keep the first `count` of no more than `most`.
  template <class T>
  void some(T* values, std::size_t count, std::size_t most) {
    static_assert(std::is_trivially_copyable_v<T>);
    const std::size_t size = count * sizeof(T);
    if (at_ != nullptr && size > 0) {
      if (pass_ == Pass::store) {
        std::memcpy(at_ + bytes_, values, size);
      } else {
        std::memcpy(values, at_ + bytes_, size);
      }
    }
    bytes_ += most * sizeof(T);
  }

  /// Have an array, which stands at `home` if it is not placed, stand in the memory once loaded.
  template <class T>
  void place(T*& values, T* home, std::size_t count) {
    static_assert(std::is_trivially_copyable_v<T>);
    bytes_ = (bytes_ + alignof(T) - 1) / alignof(T) * alignof(T);
    if (at_ != nullptr) {
      T* placed = reinterpret_cast<T*>(at_ + bytes_);
      if (pass_ == Pass::store && values != placed) std::copy_n(values, count, placed);
      if (pass_ == Pass::bring_home) std::copy_n(placed, count, home);
      if (pass_ != Pass::store) values = pass_ == Pass::load ? placed : home;
    }
    bytes_ += count * sizeof(T);
  }

  template <class T>
  void operator()(std::vector<T>& values) {
    (*this)(values.data(), values.size());
  }

  template <class T>
  void operator()(T& value) {
    (*this)(&value, 1);
  }

 private:
  enum class Pass { count, store, load, bring_home };

  Memory(std::byte* at, Pass pass) : at_(at), pass_(pass) {}

  std::byte* at_ = nullptr;
  Pass pass_ = Pass::count;
  std::size_t bytes_ = 0;
};

}  // namespace rmrc
