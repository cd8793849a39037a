#include "control/batch.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#include "control/status.hpp"

namespace rmrc {

namespace {

constexpr std::size_t line = 64;  // of a cache: what one thread writes is not beside another's

}  // namespace

Batch::Batch(int count, std::vector<Worker> workers, std::vector<double> start, int tasks)
    : count_(count),
      workers_(std::move(workers)),
      start_(std::move(start)),
      tasks_(tasks),
      targets_(count * start_.size()),
      twists_(static_cast<std::size_t>(count) * tasks * 6),
      moving_(static_cast<std::size_t>(count) * tasks),
      refused_(count),
      pool_(static_cast<int>(workers_.size())) {
  bytes_ = (kept_bytes(*workers_[0].stepper) + line - 1) / line * line;
  memory_.resize(count * bytes_);
  for (int element = 0; element < count; ++element) store(workers_[0], element);
}

Batch::~Batch() {
  // Large arrays stand in the memory that ends here.
  for (const Worker& worker : workers_) {
    Memory last = Memory::returning(memory(0));
    worker.stepper->keep(last);
  }
}

std::size_t kept_bytes(Stepper& stepper) {
  Memory counted;
  stepper.keep(counted);
  return counted.bytes();
}

void Batch::load(const Worker& worker, int element, Memory stored) {
  const std::size_t size = start_.size();
  std::copy_n(targets_.data() + element * size, size, worker.targets);
  std::copy_n(twists_.data() + element * tasks_ * 6, tasks_ * 6, worker.twists);
  std::copy_n(moving_.data() + element * tasks_, tasks_, worker.moving);
  worker.stepper->engine().rest_targets();
  worker.stepper->keep(stored);
}

void Batch::store(const Worker& worker, int element) {
  Memory stored = Memory::storing(memory(element));
  worker.stepper->keep(stored);
}

void Batch::reset(const double* q, const double* v) {
  const std::lock_guard lock(mutex_);
  const MuJoCo& is = mujoco();
  const Worker& worker = workers_[0];
  std::fill(moving_.begin(), moving_.end(), 0);
  std::fill(refused_.begin(), refused_.end(), 0);
  for (int element = 0; element < count_; ++element) {
    std::copy(start_.begin(), start_.end(), targets_.begin() + element * start_.size());
    load(worker, element, Memory::loading(memory(element)));
    worker.stepper->reset(q + element * is.nq, v + element * is.nv);
    store(worker, element);
  }
}

void Batch::aim(const TargetPlace& place, const double* values, const double* velocities,
                std::uint8_t* accepted) {
  const std::lock_guard lock(mutex_);
  const int size = place.pose ? 7 : 3;
  for (int element = 0; element < count_; ++element) {
    const int task = element * tasks_ + place.task;
    const Aim aim{place.pose, targets_.data() + element * start_.size() + place.first,
                  twists_.data() + task * 6, moving_.data() + task};
    const double* value = values + element * size;
    accepted[element] =
        aim.take({value, place.pose ? value + 3 : nullptr,
                  velocities == nullptr ? nullptr : velocities + element * aim.width()});
    refused_[element] |= accepted[element] == 0;
  }
}

void Batch::read(double* q) {
  const std::lock_guard lock(mutex_);
  const std::size_t size = mujoco().nq * sizeof(double);
  for (int element = 0; element < count_; ++element) {
    std::memcpy(q + static_cast<std::size_t>(element) * mujoco().nq, memory(element), size);
  }
}

void Batch::step(const double* q, double dt, const BatchOutput& out) {
  const std::lock_guard lock(mutex_);
  const Call call{q, dt, out};
  pool_.run(count_, [this, &call](int thread, int element) {
    take(workers_[thread], element, call);
  });
}

void Batch::take(const Worker& worker, int element, const Call& call) {
  const int nq = mujoco().nq, nv = mujoco().nv;
  load(worker, element, Memory::loading(memory(element)));
  Summary summary{};
  const double* q = call.q == nullptr ? nullptr : call.q + element * nq;
  const bool taken = worker.stepper->step(q, call.dt, summary);
  if (!taken) worker.stepper->brake(call.dt);
  store(worker, element);
  const bool valid = taken && refused_[element] == 0;
  refused_[element] = 0;
  std::copy_n(worker.stepper->state().v, nv, call.out.v + element * nv);
  std::copy_n(worker.stepper->state().q, nq, call.out.q + element * nq);
  call.out.flags[element] = static_cast<std::int32_t>(summary.flags | (valid ? 0u : status::invalid_input));
}

}  // namespace rmrc
