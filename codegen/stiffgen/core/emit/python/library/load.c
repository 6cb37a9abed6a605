/* Load the module: checks of machine and compiler, a ufunc per kernel. */
#include "ufuncs.h"

static PyUFuncGenericFunction loops[] = {loop};
static char types[MAX_OPERANDS];
static void *data[KERNELS];

/* Return an instruction set that the build uses and the machine lacks, or NULL. AVX2 includes multiply-add (FMA). */
static const char *missing_instructions(void)
{
#if defined(__GNUC__) && (defined(__x86_64__) || defined(__i386__))
    __builtin_cpu_init();
#if defined(__AVX512F__)
    if (!__builtin_cpu_supports("avx512f") || !__builtin_cpu_supports("avx512dq")
        || !__builtin_cpu_supports("avx512vl")) {
        return "AVX-512";
    }
#endif
#if defined(__AVX2__)
    if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma")) {
        return "AVX2";
    }
#endif
#if defined(__AVX__)
    if (!__builtin_cpu_supports("avx")) {
        return "AVX";
    }
#endif
#endif
    return NULL;
}

/* Raise ImportError on a machine that lacks instructions, or for a compiler that changed the arithmetic. */
static int check_build(void)
{
    const char *const missing = missing_instructions();
    if (missing != NULL) {
        PyErr_Format(PyExc_ImportError, ROBOT ": built on a machine with %s, which this one lacks; "
            "run 'stiffgen generate' here", missing);
        return -1;
    }
    if (self_check() != 0) {
        PyErr_SetString(PyExc_ImportError, ROBOT ": compiled with flags that change its arithmetic; "
            "compile it without -Ofast and its like (see CC, CFLAGS)");
        return -1;
    }
    return 0;
}

/* Make a kernel a NumPy ufunc of the module; return -1 on failure. */
static int add_ufunc(PyObject *module, int index, PyObject *arguments)
{
    const kernel *const k = &kernels[index];
    data[index] = &kernels[index];
    PyObject *const ufunc = PyUFunc_FromFuncAndDataAndSignature(loops, &data[index], types, 1, k->inputs,
        k->operands - k->inputs, PyUFunc_None, k->name, k->documentation, 0, k->signature);
    const int failed = ufunc == NULL || name_arguments(ufunc, index, arguments) < 0
        || PyModule_AddObjectRef(module, k->name, ufunc) < 0;
    Py_XDECREF(ufunc);
    return failed ? -1 : 0;
}

/* Add a ufunc per kernel to the module, and the names of their arguments. */
int add_functions(PyObject *module)
{
    if (check_build() < 0) {
        return -1;
    }
    import_array1(-1);
    import_umath1(-1);
    if (prepare_floats() < 0) {
        return -1;
    }
    for (int o = 0; o < MAX_OPERANDS; ++o) {
        types[o] = (char)NUMBER;
    }
    PyObject *const arguments = PyDict_New();
    int failed = arguments == NULL || PyModule_AddObjectRef(module, "ARGUMENTS", arguments) < 0
        || PyModule_AddStringConstant(module, "SOURCES", SOURCES) < 0;
    for (int i = 0; i < KERNELS && !failed; ++i) {
        failed = add_ufunc(module, i, arguments) < 0;
    }
    Py_XDECREF(arguments);
    return failed ? -1 : 0;
}
