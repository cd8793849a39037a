// A controller's common path in Python: targets in, a step out, its arrays when they are asked for.

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

#include "bindings.hpp"
#include "inputs.hpp"
#include "stepper.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace rmrc {

namespace {

// The numbers of an array that is plainly `size` doubles; none of anything else.
class Plain {
 public:
  Plain(nb::handle object, Py_ssize_t size) {
    constexpr int wanted = PyBUF_FORMAT | PyBUF_C_CONTIGUOUS;
    if (!PyObject_CheckBuffer(object.ptr())) return;
    if (PyObject_GetBuffer(object.ptr(), &view_, wanted) != 0) {
      PyErr_Clear();
      return;
    }
    held_ = true;
    if (view_.ndim == 1 && view_.shape[0] == size && view_.itemsize == sizeof(double) &&
        view_.format != nullptr && view_.format[0] == 'd' && view_.format[1] == 0) {
      values_ = static_cast<const double*>(view_.buf);
    }
  }
  ~Plain() {
    if (held_) PyBuffer_Release(&view_);
  }
  Plain(const Plain&) = delete;
  Plain& operator=(const Plain&) = delete;

  explicit operator bool() const { return values_ != nullptr; }
  const double* data() const { return values_; }
  double operator[](int i) const { return values_[i]; }

 private:
  Py_buffer view_;
  bool held_ = false;
  const double* values_ = nullptr;
};

// How arrays are made of a record: numpy's type and the arguments that it takes.
struct Arrays {
  struct Part {
    nb::object shape, offset;
  };

  Arrays(int nq, int nv)
      : type(nb::module_::import_("numpy").attr("ndarray")),
        number(nb::module_::import_("numpy").attr("dtype")("float64")),
        v(part(v_begins, nv)),
        q(part(v_begins + nv, nq)) {}

  static Part part(int first, int count) {
    return {nb::make_tuple(count), nb::int_(first * static_cast<int>(sizeof(double)))};
  }

  nb::object made(nb::handle record, const Part& part) const {
    PyObject* arguments[] = {part.shape.ptr(), number.ptr(), record.ptr(), part.offset.ptr()};
    PyObject* array = PyObject_Vectorcall(type.ptr(), arguments, 4, nullptr);
    if (array == nullptr) nb::raise_python_error();
    return nb::steal(array);
  }

  nb::object type, number;
  Part v, q;
};

// A step as it was taken; Python makes of it what else there is to a step.
struct Record {
  std::unique_ptr<double[]> values;
  Py_ssize_t size;
  Summary summary;
  nb::object engine;
  std::shared_ptr<const Arrays> arrays;
};

int get_buffer(PyObject* self, Py_buffer* view, int flags) {
  const Record& record = *nb::inst_ptr<Record>(self);
  const auto bytes = record.size * static_cast<Py_ssize_t>(sizeof(double));
  return PyBuffer_FillInfo(view, self, record.values.get(), bytes, 0, flags);
}

PyType_Slot record_slots[] = {{Py_bf_getbuffer, reinterpret_cast<void*>(get_buffer)}, {0, nullptr}};

nb::str interned(const char* name) {
  return nb::steal<nb::str>(PyUnicode_InternFromString(name));
}

// A target that is set at run time, with the feed-forward that moves it.
struct FedAim {
  Aim aim;
  double* feedforward;
  int rows;
};

class BoundStepper {
 public:
  BoundStepper(nb::object engine, nb::type_object step, nb::type_object record, Writing q,
               Writing v, Writing v_previous, double dt, std::vector<int> quaternions, const std::vector<bool>& frozen,
               double budget, const std::vector<Reading>& kept, Flags moving,
               const std::vector<std::tuple<int, std::vector<double>, double, double>>& watched,
               Reading targets, double tolerance)
      : engine_(std::move(engine)),
        step_(std::move(step)),
        record_(std::move(record)),
        kept_{nb::cast(q), nb::cast(v), nb::cast(v_previous), nb::cast(moving), nb::cast(targets)},
        dt_(dt) {
    Engine& native = engine_of(engine_);
    const auto nq = static_cast<std::size_t>(native.mujoco().nq);
    const auto nv = static_cast<std::size_t>(native.mujoco().nv);
    if (q.size() != nq || v.size() != nv || v_previous.size() != nv ||
        frozen.size() != static_cast<std::size_t>(native.size())) {
      throw std::invalid_argument("the state of the controller has a wrong size");
    }
    std::vector<KeptArray> arrays;
    for (const Reading& array : kept) {
      arrays.push_back({array.data(), static_cast<int>(array.size())});
      kept_.push_back(nb::cast(array));
    }
    std::vector<Watched> tasks;
    for (const auto& [term, weight, distance, angle] : watched) {
      const auto& terms = native.row_terms();
      if (term < 0 || term >= static_cast<int>(terms.size()) ||
          weight.size() != static_cast<std::size_t>(terms[term]->data().rows)) {
        throw std::invalid_argument("a watched task is none of the engine's");
      }
      tasks.push_back({term, weight, {distance, angle}});
    }
    arrays_ = std::make_shared<const Arrays>(static_cast<int>(nq), static_cast<int>(nv));
    stepper_ = std::make_unique<Stepper>(
        native,
        Progress(std::move(tasks), tolerance, targets.data(), static_cast<int>(targets.size())),
        ControllerState{q.data(), v.data(), v_previous.data()}, std::move(quaternions),
        std::vector<char>(frozen.begin(), frozen.end()), budget, std::move(arrays),
        KeptFlags{moving.data(), static_cast<int>(moving.size())});
  }

  int add_target(bool pose, Writing target, Writing twist, Writing feedforward, Flags moving) {
    if (target.size() != (pose ? 7u : 3u) || twist.size() != 6 || moving.size() != 1) {
      throw std::invalid_argument("a target has a wrong size");
    }
    for (nb::object array : {nb::cast(target), nb::cast(twist), nb::cast(feedforward),
                             nb::cast(moving)}) {
      kept_.push_back(std::move(array));
    }
    aims_.push_back({{pose, target.data(), twist.data(), moving.data()},
                     feedforward.data(),
                     static_cast<int>(feedforward.size())});
    return static_cast<int>(aims_.size()) - 1;
  }

  // Set a target from plain arrays that are valid; false, and nothing is set, for anything else.
  bool aim(int at, nb::handle position, nb::handle quaternion, nb::handle velocity) {
    const auto& [aim, feedforward, rows] = aims_[static_cast<std::size_t>(at)];
    const Plain place(position, 3), turn(quaternion, 4), rates(velocity, aim.width());
    if ((!place && !(aim.pose && position.is_none())) || (!turn && !quaternion.is_none()) ||
        (turn && !aim.pose) || (!rates && !velocity.is_none())) {
      return false;
    }
    const bool moved = *aim.moving != 0;
    if (!aim.take({place.data(), turn.data(), rates.data()})) return false;
    if (moved && !rates) std::fill_n(feedforward, rows, 0.0);
    return true;
  }

  // Take a step from plain inputs; None, and nothing is changed, for anything else.
  nb::object step(nb::handle engine, nb::handle q, nb::handle dt) {
    double seconds = dt_;
    if (!dt.is_none()) {
      if (!PyFloat_CheckExact(dt.ptr())) return nb::none();
      seconds = PyFloat_AS_DOUBLE(dt.ptr());
      if (!(shortest_step <= seconds && seconds <= longest_step)) return nb::none();
    }
    Summary summary;
    if (q.is_none()) {
      if (!stepper_->step(nullptr, seconds, summary)) return nb::none();
    } else {
      const Plain given(q, stepper_->engine().mujoco().nq);
      if (!given || !stepper_->step(given.data(), seconds, summary)) return nb::none();
    }
    const auto size = static_cast<std::size_t>(stepper_->size());
    std::unique_ptr<double[]> values(new double[size]);
    stepper_->write(values.get());
    const Engine& native = stepper_->engine();
    if (native.limits() != nullptr || native.equalities() != nullptr) {
      const double share = native.share();
      nb::setattr(engine, share_, share == 1.0 ? whole_ : nb::float_(share));
      nb::setattr(engine, relaxed_, nb::bool_(native.relaxed()));
      nb::setattr(engine, outside_, nb::bool_(stepper_->engine().outside()));
      nb::setattr(engine, behind_, nb::bool_(true));
    }
    if (native.cascaded()) nb::setattr(engine, scaled_, nb::bool_(native.scaled()));
    nb::object record = nb::inst_alloc(record_);
    new (nb::inst_ptr<Record>(record)) Record{std::move(values), static_cast<Py_ssize_t>(size),
                                              summary, nb::borrow(engine), arrays_};
    nb::inst_mark_ready(record);
    // Not by a call: what `__init__` would take is only made when it is asked for.
    auto* type = reinterpret_cast<PyTypeObject*>(step_.ptr());
    nb::object step = nb::steal(type->tp_alloc(type, 0));
    if (!step.is_valid()) nb::raise_python_error();
    nb::setattr(step, flag_bits_, nb::int_(summary.flags));
    nb::setattr(step, source_, record);
    return step;
  }

  Progress& progress() { return stepper_->progress(); }
  Stepper& stepper() { return *stepper_; }

 private:
  nb::object engine_;
  nb::type_object step_;
  nb::type_object record_;
  std::shared_ptr<const Arrays> arrays_;
  nb::str flag_bits_ = interned("flag_bits"), source_ = interned("_source");
  nb::str share_ = interned("share"), relaxed_ = interned("relaxed");
  nb::str outside_ = interned("outside"), behind_ = interned("behind");
  nb::str scaled_ = interned("scaled");
  nb::float_ whole_{1.0};
  std::vector<nb::object> kept_;
  double dt_;
  std::vector<FedAim> aims_;
  std::unique_ptr<Stepper> stepper_;
};

}  // namespace

Stepper& stepper_of(nb::handle object) { return nb::cast<BoundStepper&>(object).stepper(); }

void bind_stepper(nb::module_& m) {
  nb::class_<Record>(m, "Record", "A step as it was taken: a buffer of doubles.",
                     nb::type_slots(record_slots))
      .def_prop_ro("v", [](nb::handle_t<Record> self) {
        const Arrays& arrays = *nb::inst_ptr<Record>(self)->arrays;
        return arrays.made(self, arrays.v);
      })
      .def_prop_ro("q", [](nb::handle_t<Record> self) {
        const Arrays& arrays = *nb::inst_ptr<Record>(self)->arrays;
        return arrays.made(self, arrays.q);
      })
      .def_prop_ro("ending", [](const Record& record) { return name_of(record.summary.ending); })
      .def_prop_ro("iterations", [](const Record& record) { return record.summary.iterations; })
      .def_prop_ro("engine", [](const Record& record) { return record.engine; });
  nb::class_<BoundStepper>(m, "Stepper", "A controller's steps where nothing rare happens.")
      .def(nb::init<nb::object, nb::type_object, nb::type_object, Writing, Writing, Writing, double,
                    std::vector<int>, const std::vector<bool>&, double,
                    const std::vector<Reading>&, Flags,
                    const std::vector<std::tuple<int, std::vector<double>, double, double>>&,
                    Reading, double>(),
           nb::kw_only(), "engine"_a, "step"_a, "record"_a, "q"_a, "v"_a, "v_previous"_a, "dt"_a,
           "quaternions"_a, "frozen"_a, "budget"_a, "kept"_a, "moving"_a,
           "watched"_a, "targets"_a, "tolerance"_a)
      .def("add_target", &BoundStepper::add_target, "pose"_a, "target"_a, "twist"_a,
           "feedforward"_a, "moving"_a, "Return the number by which `aim` knows a target.")
      .def("aim", &BoundStepper::aim, nb::arg("at"), nb::arg("position").none(),
           nb::arg("quaternion").none(), nb::arg("velocity").none(),
           "Set a target from plain, valid arrays; False, and nothing is set, for others.")
      .def("step", &BoundStepper::step, nb::arg("engine"), nb::arg("q").none(),
           nb::arg("dt").none(),
           "Take a step from plain, valid inputs; None, and nothing is changed, for others.")
      .def("reset", [](BoundStepper& bound) { bound.progress().reset(); },
           "Forget the progress that was made.")
      .def(
          "update",
          [](BoundStepper& bound, const Reading& v, double dt) {
            const Engine& engine = bound.stepper().engine();
            if (v.size() != static_cast<std::size_t>(engine.size())) {
              throw std::invalid_argument("v has a wrong size");
            }
            bound.progress().update(engine, v.data(), dt);
          },
          "v"_a, "dt"_a, "Take note of a command v (n,) at the last evaluation, for a step of dt.")
      .def_prop_ro("stuck", [](BoundStepper& bound) { return bound.progress().stuck(); },
                   "Whether the tasks are stuck.");
}

}  // namespace rmrc
