// The two calls of a control loop: methods of Python's that are tried here first. They are of
// CPython's own protocol: to bind them by nanobind costs more than all that they do.

#include <Python.h>
#include <structmember.h>

#include <cstddef>

#include "control/status.hpp"
#include "python/bindings.hpp"
#include "python/bound_stepper.hpp"
#include "python/record.hpp"

namespace nb = nanobind;

namespace rmrc {

namespace {

// rmrc.control.controller.FAILED
constexpr unsigned failed =
    status::max_iter | status::deadline | status::stale | status::invalid_input;

// Interned names of this process.
struct Names {
  PyObject *quick, *refused, *failures;
  PyObject* step[4];    // the arguments of `Controller.step`
  PyObject* target[6];  // the arguments of `Controller.set_target`
  PyTypeObject* stepper;
};
Names names{};

// A method: `function` is called for all that is not plain.
struct Method {
  PyObject_HEAD
  vectorcallfunc call;
  PyObject* function;
};

PyObject* in_python(PyObject* self, PyObject* const* arguments, std::size_t count,
                    PyObject* keywords) {
  PyErr_Clear();
  return PyObject_Vectorcall(reinterpret_cast<Method*>(self)->function, arguments, count, keywords);
}

// Sort arguments by their names, null or None for what is not given; false if they do not fit.
template <std::size_t size>
bool sort(PyObject* const* arguments, Py_ssize_t count, PyObject* keywords, Py_ssize_t most,
          PyObject* const (&known)[size], PyObject* (&sorted)[size]) {
  if (count > most) return false;
  for (Py_ssize_t i = 0; i < count; ++i) sorted[i] = arguments[i];
  const Py_ssize_t named = keywords == nullptr ? 0 : PyTuple_GET_SIZE(keywords);
  for (Py_ssize_t k = 0; k < named; ++k) {
    std::size_t i = 0;
    while (i < size && known[i] != PyTuple_GET_ITEM(keywords, k)) ++i;
    if (i == size || sorted[i] != nullptr) return false;
    sorted[i] = arguments[count + k];
  }
  return true;
}

bool given(PyObject* argument) { return argument != nullptr && argument != Py_None; }

// Return what takes the steps of a controller, if anything does, with a reference that keeps it.
BoundStepper* quick_of(PyObject* controller, nb::object& kept) {
  kept = nb::steal(PyObject_GetAttr(controller, names.quick));
  if (!kept.is_valid() || !Py_IS_TYPE(kept.ptr(), names.stepper)) return nullptr;
  return nb::inst_ptr<BoundStepper>(kept);
}

PyObject* set_target(PyObject* self, PyObject* const* arguments, std::size_t flagged,
                     PyObject* keywords) {
  const Py_ssize_t count = PyVectorcall_NARGS(flagged);
  PyObject* sorted[6] = {};
  nb::object kept;
  if (count < 1 || !sort(arguments + 1, count - 1, keywords, 4, names.target, sorted)) {
    return in_python(self, arguments, flagged, keywords);
  }
  const auto [name, position, quaternion, velocity, q, direction] = sorted;
  BoundStepper* quick = name == nullptr ? nullptr : quick_of(arguments[0], kept);
  const int width = quick == nullptr ? 0 : quick->width_of(name);
  if (width == 0 || given(q) || given(direction)) {
    return in_python(self, arguments, flagged, keywords);
  }
  const bool pose = width == 6;
  const Given numbers{given(position) ? plain(position, 3) : nullptr,
                      given(quaternion) ? plain(quaternion, 4) : nullptr,
                      given(velocity) ? plain(velocity, width) : nullptr};
  const bool understood = (pose || numbers.position != nullptr) &&
                          given(position) == (numbers.position != nullptr) &&
                          given(quaternion) == (pose && numbers.quaternion != nullptr) &&
                          given(velocity) == (numbers.velocity != nullptr);
  if (!understood || !quick->aim(name, numbers)) {
    return in_python(self, arguments, flagged, keywords);
  }
  return Py_NewRef(Py_True);
}

// Whether an input was refused since the last step: Python says what was wrong with it.
bool has_refused(PyObject* controller) {
  const nb::object refused = nb::steal(PyObject_GetAttr(controller, names.refused));
  if (refused.is_valid()) return PyObject_IsTrue(refused.ptr()) != 0;
  PyErr_Clear();
  return true;
}

// Take note of how a step has ended.
bool note(PyObject* controller, const Summary& summary) {
  const nb::object failures = nb::steal(PyObject_GetAttr(controller, names.failures));
  if (!failures.is_valid()) return false;
  const long before = PyLong_AsLong(failures.ptr());
  if (before == -1 && PyErr_Occurred() != nullptr) return false;
  const bool counts = (summary.flags & failed) != 0;
  const long now = counts ? before + (before < std::numeric_limits<long>::max() ? 1 : 0) : 0;
  if (now == before) return true;
  const nb::object number = nb::steal(PyLong_FromLong(now));
  return number.is_valid() && PyObject_SetAttr(controller, names.failures, number.ptr()) == 0;
}

PyObject* step(PyObject* self, PyObject* const* arguments, std::size_t flagged,
               PyObject* keywords) {
  const Py_ssize_t count = PyVectorcall_NARGS(flagged);
  PyObject* sorted[4] = {};  // v and age are for controllers that nothing is quick for
  nb::object kept;
  BoundStepper* quick = count < 1 ? nullptr : quick_of(arguments[0], kept);
  if (quick == nullptr || has_refused(arguments[0]) ||
      !sort(arguments + 1, count - 1, keywords, 4, names.step, sorted)) {
    return in_python(self, arguments, flagged, keywords);
  }
  const auto [q, dt, v, age] = sorted;
  double seconds = quick->dt();
  if (given(dt)) {
    if (!PyFloat_CheckExact(dt)) return in_python(self, arguments, flagged, keywords);
    seconds = PyFloat_AS_DOUBLE(dt);
    if (!(shortest_step <= seconds && seconds <= longest_step)) {
      return in_python(self, arguments, flagged, keywords);
    }
  }
  Stepper& stepper = quick->stepper();
  const double* measured = given(q) ? plain(q, stepper.mujoco().nq) : nullptr;
  Summary summary;
  if (given(q) && measured == nullptr) return in_python(self, arguments, flagged, keywords);
  if (!stepper.step(measured, seconds, summary)) {
    return in_python(self, arguments, flagged, keywords);
  }
  quick->tell();
  if (!note(arguments[0], summary)) return nullptr;
  return make_step(stepper, summary, quick->owner().ptr());
}

int traverse(PyObject* self, visitproc visit, void* arg) {
  Py_VISIT(Py_TYPE(self));
  Py_VISIT(reinterpret_cast<Method*>(self)->function);
  return 0;
}

int clear(PyObject* self) {
  Py_CLEAR(reinterpret_cast<Method*>(self)->function);
  return 0;
}

void deallocate(PyObject* self) {
  PyTypeObject* type = Py_TYPE(self);
  PyObject_GC_UnTrack(self);
  clear(self);
  type->tp_free(self);
  Py_DECREF(type);
}

PyObject* bound(PyObject* self, PyObject* object, PyObject*) {
  return object == nullptr ? Py_NewRef(self) : PyMethod_New(self, object);
}

// What a function says of itself, a method says as well.
PyObject* said(PyObject* self, void* name) {
  return PyObject_GetAttrString(reinterpret_cast<Method*>(self)->function,
                                static_cast<const char*>(name));
}

PyTypeObject* make_method_type() {
  static char doc[] = "__doc__", name[] = "__name__", full_name[] = "__qualname__";
  static char annotations[] = "__annotations__";
  static PyGetSetDef attributes[] = {{"__doc__", said, nullptr, nullptr, doc},
                                     {"__annotations__", said, nullptr, nullptr, annotations},
                                     {"__name__", said, nullptr, nullptr, name},
                                     {"__qualname__", said, nullptr, nullptr, full_name},
                                     {}};
  static PyMemberDef members[] = {
      {"__vectorcalloffset__", T_PYSSIZET, offsetof(Method, call), READONLY, nullptr},
      {"__wrapped__", T_OBJECT, offsetof(Method, function), READONLY, nullptr},
      {}};
  static PyType_Slot slots[] = {
      {Py_tp_dealloc, reinterpret_cast<void*>(deallocate)},
      {Py_tp_traverse, reinterpret_cast<void*>(traverse)},
      {Py_tp_clear, reinterpret_cast<void*>(clear)},
      {Py_tp_call, reinterpret_cast<void*>(PyVectorcall_Call)},
      {Py_tp_descr_get, reinterpret_cast<void*>(bound)},
      {Py_tp_members, members},
      {Py_tp_getset, attributes},
      {0, nullptr}};
  constexpr unsigned flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC |
                             Py_TPFLAGS_HAVE_VECTORCALL | Py_TPFLAGS_METHOD_DESCRIPTOR |
                             Py_TPFLAGS_DISALLOW_INSTANTIATION;
  static PyType_Spec spec{"rmrc._native.Method", sizeof(Method), 0, flags, slots};
  return reinterpret_cast<PyTypeObject*>(PyType_FromSpec(&spec));
}

nb::object method(PyTypeObject* type, vectorcallfunc call, nb::object function) {
  auto* made = reinterpret_cast<Method*>(type->tp_alloc(type, 0));
  if (made == nullptr) nb::raise_python_error();
  made->call = call;
  made->function = function.release().ptr();
  return nb::steal(reinterpret_cast<PyObject*>(made));
}

template <std::size_t size>
void intern(PyObject* (&out)[size], const char* const (&of)[size]) {
  for (std::size_t i = 0; i < size; ++i) out[i] = PyUnicode_InternFromString(of[i]);
}

}  // namespace

void bind_loop(nb::module_& m) {
  PyTypeObject* type = make_method_type();
  if (type == nullptr) nb::raise_python_error();
  names.quick = PyUnicode_InternFromString("stepper");
  names.refused = PyUnicode_InternFromString("_refused");
  names.failures = PyUnicode_InternFromString("failures");
  intern(names.step, {"q", "dt", "v", "age"});
  intern(names.target, {"name", "position", "quaternion", "velocity", "q", "direction"});
  names.stepper = reinterpret_cast<PyTypeObject*>(nb::type<BoundStepper>().ptr());
  m.def("quick_step", [type](nb::object function) { return method(type, step, function); },
        nb::arg("function"), "Return `Controller.step`, which is `function` for what is not plain.");
  m.def("quick_target",
        [type](nb::object function) { return method(type, set_target, function); },
        nb::arg("function"),
        "Return `Controller.set_target`, which is `function` for what is not plain.");
}

}  // namespace rmrc
