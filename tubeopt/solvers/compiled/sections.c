/* Cross-sections of tubes. */

/* Of one tube; rate: 1 / GJ, twist_angle: integral of u*_z, phase: direction of the bend with that. */
typedef struct {
    double stiffness, moment, phase, rate, twist_angle;
} Section;

/* Of all tubes at one place. */
typedef struct {
    double stiffness[N], moment[N], phase[N], rate[N], twist_angle[N];
} Sections;

/* The same of WIDTH robots. */
#if ABREAST
typedef struct {
    Real stiffness, moment, phase, rate, twist_angle;
} SectionAbreast;

typedef struct {
    Real stiffness[N], moment[N], phase[N], rate[N], twist_angle[N];
} SectionsAbreast;
#else
typedef Section SectionAbreast;
typedef Sections SectionsAbreast;
#endif

static inline void put_section(Sections *at, int i, Section one) {
    at->stiffness[i] = one.stiffness;
    at->moment[i] = one.moment;
    at->phase[i] = one.phase;
    at->rate[i] = one.rate;
    at->twist_angle[i] = one.twist_angle;
}

static inline Section section_in(const Sections *at, int i) {
    return (Section){at->stiffness[i], at->moment[i], at->phase[i], at->rate[i], at->twist_angle[i]};
}
