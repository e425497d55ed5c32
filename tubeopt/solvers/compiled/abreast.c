/* Many robots along their branches, ROBOTS side by side: those whose meshes have the same pieces, and differ by lengths. */

#define MOST_ABREAST 20 /* steps of ordinary length */

/* Of robots side by side a number of one. */
#define TAKE(field, count) \
    for (long long k = 0; k < (long long)(count); k++) ((double *)&to->field)[k] = ((const Real *)&from->field)[k][which]

/* The answer of one robot: what the next step and a tip need. */
static void take_answer(const Workspace *w, int which, Answer *to) {
    const Answers *from = &w->answers;
    const Layout *l = w->layout + which;
    long long shape = from->pieces * STEPS + 1;
    TAKE(margin, 7); /* and the numbers behind it */
    memcpy(&to->pieces, &from->pieces, 5 * sizeof to->pieces);
    TAKE(tip_rotations, N);
    for (int i = 0; i < N; i++) to->tube_end[i] = fmax(l->end[i], 0.0);
    memcpy(to->section_start, l->section_start, sizeof to->section_start);
    TAKE(point, from->points);
    TAKE(point_rotation, from->points * N);
    TAKE(arc_length, shape);
    TAKE(rotation, shape * N);
    TAKE(torsion, shape * N);
    TAKE(position[shape - 1], 3);
    TAKE(frame[shape - 1], 9);
}

/* Numbers of one robot for the summary of `solve_many`. */
static void summarise(const Answers *one, int which, double *summary) {
    long long tip = one->pieces * STEPS;
    Real rest[5] = {one->margin, one->residual, one->mesh_error, one->tip_error, one->energy};
    for (int r = 0; r < 3; r++) summary[r] = one->position[tip][r][which];
    for (int r = 0; r < 9; r++) summary[3 + r] = one->frame[tip][r][which];
    for (int i = 0; i < N; i++) summary[12 + i] = one->tip_rotations[i][which];
    for (int r = 0; r < 5; r++) summary[12 + N + r] = rest[r][which];
}

/* A row on its way: a number that rows share whose meshes have the same pieces, and the steps of ordinary length that it takes
   and has taken; none where it is left as it was. */
typedef struct {
    unsigned long long mesh;
    long long row, steps, taken;
} Job;

static int by_mesh(const void *a, const void *b) {
    const Job *x = a, *y = b;
    return x->mesh == y->mesh ? (x->row > y->row) - (x->row < y->row) : (x->mesh > y->mesh) - (x->mesh < y->mesh);
}

/* That number; 0 where tubes vary along a piece, or an arm has no length. */
static unsigned long long mesh_of(const Tubes *tubes, const Layout *l) {
    unsigned long long mesh = (unsigned long long)l->pieces;
    for (int i = 0; i < N; i++)
        if (winds(tubes->pieces, i)) return 0;
    for (int p = 0; p < l->pieces; p++) {
        const Across *a = l->across + p;
        if (!a->steady) return 0;
        mesh = mesh * 1099511628211ULL + (unsigned)(2 * l->section[p] + l->collocated[p]);
        for (int i = 0; i < N; i++) mesh = mesh * 1099511628211ULL + (unsigned)(2 * a->present[i] + a->curved[i] + 1);
    }
    return mesh;
}

/* Straight motions of rows. */
typedef struct {
    const Tubes *const *tubes;
    const double *alpha, *shift, *to_alpha, *to_shift;
} Motions;

/* Joint values of a row after some of its steps. */
static void joints_of(const Motions *m, const Job *job, long long taken, double *alpha, double *shift) {
    double rest = 1 - (double)taken / job->steps;
    for (int i = 0; i < N; i++) {
        long long k = job->row * N + i;
        alpha[i] = m->to_alpha[k] - rest * (m->to_alpha[k] - m->alpha[k]);
        shift[i] = m->to_shift[k] - rest * (m->to_shift[k] - m->shift[k]);
    }
}

/* The next step of up to ROBOTS rows with meshes of the same pieces. A row that is not at ease has no steps any more. */
static void step_abreast(const Motions *m, Job *jobs, int count, Answer *arms, Workspace *w) {
    double turn[ROBOTS][N], shift[ROBOTS][N];
    Guess guesses[ROBOTS];
    Real alpha[N], margin;
    for (int which = 0; which < ROBOTS; which++) {
        const Job *job = jobs + (which < count ? which : 0);
        double from[N], to[N], to_shift[N];
        joints_of(m, job, job->taken, from, shift[which]);
        joints_of(m, job, job->taken + 1, to, to_shift);
        lay_out(m->tubes[job->row], to_shift, NULL, w->layout + which);
        for (int i = 0; i < N; i++) {
            alpha[i][which] = to[i];
            turn[which][i] = to[i] - from[i];
        }
        guesses[which] = guess_of(arms + job->row, turn[which], shift[which]);
        margin[which] = arms[job->row].margin;
    }
    Answers *next = &w->answers;
    Truth left = solve_on(m->tubes[jobs->row], alpha, guesses, w, next);
    left |= (next->margin < margin / 2) | (next->contraction > LARGEST_RATIO);
    left |= next->largest_change > fmin(fmax(2 * margin * LARGEST_TWIST, REAL(SOFT_TWIST)), REAL(LARGEST_TWIST));
    for (int which = 0; which < count; which++) {
        if (left[which]) jobs[which].steps = 0;
        else take_answer(w, which, arms + jobs[which].row), jobs[which].taken++;
    }
}

/* What `follow_many` does, of rows whose steps are at ease side by side; others are left as they are. `jobs` and `kept` have room
   for as many as there are rows. */
CASADI_SYMBOL_EXPORT void follow_abreast(const Tubes *const *tubes, long long count, double *alpha, double *shift, const double *to_alpha,
                                         const double *to_shift, const unsigned char *cold, Answer *arms, Job *jobs, Answer *kept,
                                         Workspace *w) {
    Motions m = {tubes, alpha, shift, to_alpha, to_shift};
    long long known = 0;
    size_t joints = N * sizeof(double);
    for (long long k = 0, at = 0; k < count; k++, at += N) {
        if (cold[k] || (!memcmp(alpha + at, to_alpha + at, joints) && !memcmp(shift + at, to_shift + at, joints))) continue;
        double length = fmax(arms[k].arc_length[arms[k].pieces * STEPS], tubes[k]->whole[0] / 10);
        double steps = parts_of(alpha + at, shift + at, to_alpha + at, to_shift + at, length);
        if (!(steps <= MOST_ABREAST)) continue;
        jobs[known++] = (Job){0, k, (long long)steps, 0};
        if (steps > 1) copy_answer(arms + k, kept + k);
    }
    for (int going = 1; going;) {
        going = 0;
        for (long long j = 0; j < known; j++) {
            double at[N], at_shift[N];
            jobs[j].mesh = 0;
            if (jobs[j].taken >= jobs[j].steps) continue;
            joints_of(&m, jobs + j, jobs[j].taken + 1, at, at_shift);
            if (lay_out(tubes[jobs[j].row], at_shift, NULL, w->layout)) jobs[j].mesh = mesh_of(tubes[jobs[j].row], w->layout);
            if (jobs[j].mesh) going = 1;
            else jobs[j].steps = 0;
        }
        qsort(jobs, known, sizeof(Job), by_mesh);
        for (long long first = 0, end; first < known; first = end) {
            for (end = first; end < known && end < first + ROBOTS && jobs[end].mesh == jobs[first].mesh;) end++;
            if (!jobs[first].mesh) continue;
            if (end == first + 1) jobs[first].steps = 0; /* one alone is no faster here */
            else step_abreast(&m, jobs + first, (int)(end - first), arms, w);
        }
    }
    for (long long j = 0; j < known; j++) {
        long long at = jobs[j].row * N;
        if (!jobs[j].steps && jobs[j].taken) copy_answer(kept + jobs[j].row, arms + jobs[j].row);
        if (!jobs[j].steps) continue;
        memcpy(alpha + at, to_alpha + at, joints);
        memcpy(shift + at, to_shift + at, joints);
    }
}

/* What `solve_many` does, of rows that are solved side by side; `declined` (count): 1 of others. */
CASADI_SYMBOL_EXPORT void solve_abreast(const Tubes *tubes, long long count, const double *alpha, const double *shift, double *summary,
                                        unsigned char *declined, Job *jobs, Workspace *w) {
    memset(declined, 1, count);
    for (long long k = 0; k < count; k++) {
        jobs[k] = (Job){0, k, 0, 0};
        if (lay_out(tubes, shift + k * N, NULL, w->layout)) jobs[k].mesh = mesh_of(tubes, w->layout);
    }
    qsort(jobs, count, sizeof(Job), by_mesh);
    for (long long first = 0, end; first < count; first = end) {
        Real at[N];
        for (end = first; end < count && end < first + ROBOTS && jobs[end].mesh == jobs[first].mesh;) end++;
        if (!jobs[first].mesh) continue;
        for (int which = 0; which < ROBOTS; which++) {
            long long row = jobs[first + which < end ? first + which : first].row;
            lay_out(tubes, shift + row * N, NULL, w->layout + which);
            for (int i = 0; i < N; i++) at[i][which] = alpha[row * N + i];
        }
        Truth left = solve_on(tubes, at, NULL, w, &w->answers);
        for (int which = 0; which < end - first; which++) {
            long long row = jobs[first + which].row;
            declined[row] = left[which] != 0;
            if (!left[which]) summarise(&w->answers, which, summary + row * (17 + N));
        }
    }
}

CASADI_SYMBOL_EXPORT size_t workspace_size(void) { return sizeof(Workspace); }
CASADI_SYMBOL_EXPORT size_t answer_size(void) { return sizeof(Answer); }
