// Threads that share out a number of items.
#pragma once

#include <atomic>
#include <condition_variable>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace rmrc {

/// Sleeps until there is work, which the threads then take in small portions by a counter.
///
/// The thread that calls `run` is one of them, and waits only for those that have begun: it goes on
/// alone where the others are late, or are gone as after a fork.
class ThreadPool {
 public:
  /// What is done with one item by one of the threads, 0 … threads − 1; it throws nothing.
  using Work = std::function<void(int thread, int item)>;

  explicit ThreadPool(int threads);
  ~ThreadPool();
  ThreadPool(const ThreadPool&) = delete;
  ThreadPool& operator=(const ThreadPool&) = delete;

  /// Do the work on items 0 … count − 1, and return when all of it is done.
  void run(int count, const Work& work);

 private:
  void serve(int thread);
  void take(int thread, int count, const Work& work);

  std::mutex mutex_;
  std::condition_variable wake_, done_;
  const Work* work_ = nullptr;  // null between two runs
  int count_ = 0, busy_ = 0;
  unsigned round_ = 0;
  bool stopped_ = false;
  std::atomic<int> next_{0};
  std::vector<std::thread> threads_;
};

}  // namespace rmrc
