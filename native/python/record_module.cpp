// A step in Python. What the loop reads of it, v and q, is made here; the rest in Python, of a copy
// of its numbers. The types are CPython's own: nanobind's calls cost more than all that they do.

#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#include <Python.h>
#include <numpy/arrayobject.h>
#include <structmember.h>

#include <algorithm>
#include <cstddef>

#include "python/bindings.hpp"
#include "python/record.hpp"

namespace nb = nanobind;

namespace rmrc {

namespace {

// The numbers of a step. It takes no part in the collection of garbage: an engine knows no steps.
struct Record {
  PyObject_VAR_HEAD
  PyObject* owner;
  Summary summary;
  int nq, nv;
  double values[1];
};

// What a step holds behind what Python's `Step` has slots for: null until it is asked for, but for
// the record. As members they are visited and released as slots are.
struct Extra {
  PyObject *record, *v, *q, *source;
};

// The types, which live as long as the process; where `Extra` and the slot `flag_bits` stand in a
// step; and what makes the source of all else of a record.
struct Types {
  PyTypeObject *record, *step;
  Py_ssize_t extra, flag_bits;
  PyObject* source;
};
Types types{};

Extra& extra_of(PyObject* step) {
  return *reinterpret_cast<Extra*>(reinterpret_cast<char*>(step) + types.extra);
}

PyObject* array_of(const double* values, npy_intp size) {
  PyObject* array = PyArray_SimpleNew(1, &size, NPY_DOUBLE);
  if (array == nullptr) return nullptr;
  std::copy_n(values, size,
              static_cast<double*>(PyArray_DATA(reinterpret_cast<PyArrayObject*>(array))));
  return array;
}

const Record& record_of(PyObject* object) { return *reinterpret_cast<Record*>(object); }

PyObject* get_v(PyObject* self, void*) {
  Extra& extra = extra_of(self);
  if (extra.v == nullptr) {
    const Record& record = record_of(extra.record);
    extra.v = array_of(record.values + v_begins, record.nv);
  }
  return Py_XNewRef(extra.v);
}

PyObject* get_q(PyObject* self, void*) {
  Extra& extra = extra_of(self);
  if (extra.q == nullptr) {
    const Record& record = record_of(extra.record);
    extra.q = array_of(record.values + v_begins + record.nv, record.nq);
  }
  return Py_XNewRef(extra.q);
}

PyObject* get_source(PyObject* self, void*) {
  Extra& extra = extra_of(self);
  if (extra.source == nullptr) extra.source = PyObject_CallOneArg(types.source, extra.record);
  return Py_XNewRef(extra.source);
}

PyObject* get_numbers(PyObject* self, void*) {
  return array_of(record_of(self).values, Py_SIZE(self));
}

PyObject* get_ending(PyObject* self, void*) {
  return PyUnicode_FromString(name_of(record_of(self).summary.ending));
}

PyObject* get_iterations(PyObject* self, void*) {
  return PyLong_FromLong(record_of(self).summary.iterations);
}

PyObject* get_engine(PyObject* self, void*) { return Py_NewRef(record_of(self).owner); }

void free_record(PyObject* self) {
  PyTypeObject* type = Py_TYPE(self);
  Py_DECREF(record_of(self).owner);
  type->tp_free(self);
  Py_DECREF(type);
}

PyTypeObject* make_record_type() {
  static PyGetSetDef attributes[] = {
      {"numbers", get_numbers, nullptr, "A copy of all of them.", nullptr},
      {"ending", get_ending, nullptr, "The value of the `SolveStatus`.", nullptr},
      {"iterations", get_iterations, nullptr, "Changes of the active set.", nullptr},
      {"engine", get_engine, nullptr, "The Python engine that took the step.", nullptr},
      {}};
  static PyType_Slot slots[] = {{Py_tp_dealloc, reinterpret_cast<void*>(free_record)},
                                {Py_tp_getset, attributes},
                                {Py_tp_doc, const_cast<char*>("A step as it was taken.")},
                                {0, nullptr}};
  static PyType_Spec spec{"rmrc._native.Record", offsetof(Record, values), sizeof(double),
                          Py_TPFLAGS_DEFAULT | Py_TPFLAGS_DISALLOW_INSTANTIATION, slots};
  return reinterpret_cast<PyTypeObject*>(PyType_FromSpec(&spec));
}

// Derive the type of the steps that are made here from Python's `Step`.
void set_step_type(nb::type_object base, nb::object source) {
  const auto* parent = reinterpret_cast<PyTypeObject*>(base.ptr());
  const nb::object slot = base.attr("flag_bits");
  if (!Py_IS_TYPE(slot.ptr(), &PyMemberDescr_Type)) throw nb::type_error("flag_bits is no slot");
  types.flag_bits = reinterpret_cast<PyMemberDescrObject*>(slot.ptr())->d_member->offset;
  types.extra = parent->tp_basicsize;
  const auto at = [&](std::size_t field) {
    return types.extra + static_cast<Py_ssize_t>(field);
  };
  PyMemberDef members[] = {
      {"_record", T_OBJECT_EX, at(offsetof(Extra, record)), 0, nullptr},
      {"_v", T_OBJECT_EX, at(offsetof(Extra, v)), 0, nullptr},
      {"_q", T_OBJECT_EX, at(offsetof(Extra, q)), 0, nullptr},
      {"_made", T_OBJECT_EX, at(offsetof(Extra, source)), 0, nullptr},
      {}};
  static PyGetSetDef attributes[] = {{"v", get_v, nullptr, "See `Step.v`.", nullptr},
                                     {"q", get_q, nullptr, "See `Step.q`.", nullptr},
                                     {"_source", get_source, nullptr, nullptr, nullptr},
                                     {}};
  PyType_Slot slots[] = {
      {Py_tp_members, members}, {Py_tp_getset, attributes}, {0, nullptr}};
  PyType_Spec spec{"rmrc.control.step.Step", static_cast<int>(types.extra + sizeof(Extra)), 0,
                   Py_TPFLAGS_DEFAULT | Py_TPFLAGS_DISALLOW_INSTANTIATION, slots};
  PyObject* made = PyType_FromSpecWithBases(&spec, base.ptr());
  if (made == nullptr) nb::raise_python_error();
  types.step = reinterpret_cast<PyTypeObject*>(made);
  types.source = source.release().ptr();
}

}  // namespace

const double* plain(PyObject* object, Py_ssize_t size) {
  if (!PyArray_CheckExact(object)) return nullptr;
  auto* array = reinterpret_cast<PyArrayObject*>(object);
  const bool fits = PyArray_TYPE(array) == NPY_DOUBLE && PyArray_NDIM(array) == 1 &&
                    PyArray_DIM(array, 0) == size && PyArray_ISCARRAY_RO(array);
  return fits ? static_cast<const double*>(PyArray_DATA(array)) : nullptr;
}

PyObject* make_step(const Stepper& stepper, const Summary& summary, PyObject* owner) {
  if (types.step == nullptr) {
    PyErr_SetString(PyExc_RuntimeError, "set_step_type comes before the first step");
    return nullptr;
  }
  auto* record =
      reinterpret_cast<Record*>(PyObject_NewVar(Record, types.record, stepper.size()));
  if (record == nullptr) return nullptr;
  record->owner = Py_NewRef(owner);
  record->summary = summary;
  record->nq = stepper.mujoco().nq;
  record->nv = stepper.mujoco().nv;
  stepper.write(record->values);
  PyObject* step = types.step->tp_alloc(types.step, 0);
  if (step == nullptr) {
    Py_DECREF(record);
    return nullptr;
  }
  extra_of(step).record = reinterpret_cast<PyObject*>(record);
  PyObject* flags = PyLong_FromUnsignedLong(summary.flags);
  if (flags == nullptr) {
    Py_DECREF(step);
    return nullptr;
  }
  *reinterpret_cast<PyObject**>(reinterpret_cast<char*>(step) + types.flag_bits) = flags;
  return step;
}

void bind_record(nb::module_& m) {
  if (_import_array() < 0) nb::raise_python_error();
  types.record = make_record_type();
  if (types.record == nullptr) nb::raise_python_error();
  m.attr("Record") = nb::handle(reinterpret_cast<PyObject*>(types.record));
  m.def("set_step_type", &set_step_type, nb::arg("base"), nb::arg("source"),
        "Have steps made as instances of `base`, with `source` to make the rest of a record.");
}

}  // namespace rmrc
