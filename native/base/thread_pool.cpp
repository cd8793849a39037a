#include "base/thread_pool.hpp"

#include <algorithm>

namespace rmrc {

namespace {

// Items of one portion, at most: many portions a thread even out, and a counter costs nothing
// beside one. Few items are so many portions a thread as well.
constexpr int largest_portion = 16;
constexpr int portions = 8;

}  // namespace

ThreadPool::ThreadPool(int threads) {
  for (int thread = 1; thread < threads; ++thread) {
    threads_.emplace_back([this, thread] { serve(thread); });
  }
}

ThreadPool::~ThreadPool() {
  {
    const std::lock_guard lock(mutex_);
    stopped_ = true;
  }
  wake_.notify_all();
  for (std::thread& thread : threads_) thread.join();
}

void ThreadPool::run(int count, const Work& work) {
  {
    const std::lock_guard lock(mutex_);
    work_ = &work;
    count_ = count;
    next_ = 0;
    ++round_;
  }
  wake_.notify_all();
  take(0, count, work);
  std::unique_lock lock(mutex_);
  work_ = nullptr;  // who wakes up now is too late
  done_.wait(lock, [this] { return busy_ == 0; });
}

void ThreadPool::serve(int thread) {
  std::unique_lock lock(mutex_);
  for (unsigned seen = 0;;) {
    wake_.wait(lock, [&] { return stopped_ || (work_ != nullptr && round_ != seen); });
    if (stopped_) return;
    seen = round_;
    ++busy_;
    const Work& work = *work_;
    const int count = count_;
    lock.unlock();
    take(thread, count, work);
    lock.lock();
    if (--busy_ == 0) done_.notify_one();
  }
}

void ThreadPool::take(int thread, int count, const Work& work) {
  const int threads = static_cast<int>(threads_.size()) + 1;
  const int portion = std::clamp(count / (portions * threads), 1, largest_portion);
  for (int first; (first = next_.fetch_add(portion)) < count;) {
    const int last = std::min(first + portion, count);
    for (int item = first; item < last; ++item) work(thread, item);
  }
}

}  // namespace rmrc
