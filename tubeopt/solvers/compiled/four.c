/* Four numbers side by side. gcc and clang work on them at once: EACH(...) is its statement, FOUR(place) the four at a
   place, OF(x) a variable that is a Four. Elsewhere, or with TUBEOPT_PORTABLE, EACH says the statement for one after the other. */
#if (defined(__GNUC__) || defined(__clang__)) && !defined(TUBEOPT_PORTABLE)
typedef double Four __attribute__((vector_size(4 * sizeof(double)), aligned(sizeof(double)), may_alias));
#define FOUR(place) (*(Four *)(place))
#define OF(x) (x)
#define EACH(...) __VA_ARGS__
#define ALWAYS_INLINE static inline __attribute__((always_inline))
#else
typedef double Four[4];
#define FOUR(place) ((place)[lane])
#define OF(x) ((x)[lane])
#define EACH(...) for (int lane = 0; lane < 4; lane++) { __VA_ARGS__; }
#define ALWAYS_INLINE static inline
#endif
