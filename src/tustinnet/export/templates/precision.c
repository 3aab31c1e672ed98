#ifdef MODEL_FLOAT
#define M(name) name##f
#define EITHER(in_double, in_float) in_float
#else
#define M(name) name
#define EITHER(in_double, in_float) in_double
#endif
#define R(x) MODEL_NUMBER(x)
