// What a controller keeps from one step to the next, copied out of it and back into it.
#pragma once

#include <cstddef>
#include <cstring>
#include <type_traits>
#include <vector>

namespace rmrc {

/// Goes through what is kept, which each class names once in its `keep`: one pass counts the bytes,
/// one stores them, one loads them again. The sizes must be the same in all.
class Memory {
 public:
  /// Count the bytes.
  Memory() = default;

  static Memory storing(std::byte* at) { return Memory(at, true); }
  static Memory loading(std::byte* at) { return Memory(at, false); }

  std::size_t bytes() const { return bytes_; }

  template <class T>
  void operator()(T* values, std::size_t count) {
    static_assert(std::is_trivially_copyable_v<T>);
    const std::size_t size = count * sizeof(T);
    if (at_ != nullptr && size > 0) {
      if (storing_) {
        std::memcpy(at_ + bytes_, values, size);
      } else {
        std::memcpy(values, at_ + bytes_, size);
      }
    }
    bytes_ += size;
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
  Memory(std::byte* at, bool storing) : at_(at), storing_(storing) {}

  std::byte* at_ = nullptr;
  bool storing_ = false;
  std::size_t bytes_ = 0;
};

}  // namespace rmrc
