/* A motion of tubes that rub along each other, increment by increment: what equilibrium/friction.py, solvers/friction_increment.py and
   stability/friction_path.py do where all goes well. What does not (a step that Newton's method is not at ease with, a
   snap, a state that is held by friction alone) ends it, and is left to them. */
#include "stick_slip.c"

#define LONG 0.3 /* part of the longest step of a state with margin 0 from which the next may be longer still */
#define HARDLY_SOFTER 1e-6 /* 1 / margin - 1 below which margins differ from 1 less accurately: eigenvalues gather there */

/* A state: rows of friction by pair, then by point; `outer` and `inner` are their unknowns. */
typedef struct {
    Layout layout;
    Unknowns q;
    State state;
    Profile arm;
    int rows, pair[MOST_UNKNOWNS], point[MOST_UNKNOWNS], outer[MOST_UNKNOWNS], inner[MOST_UNKNOWNS];
    double most[MOST_UNKNOWNS], torque[MOST_UNKNOWNS], turned[MOST_UNKNOWNS]; /* largest torque, torque, rotation */
    signed char sign[MOST_UNKNOWNS];
    double alpha[N], shift[N], margin;       /* 0 where it is not known: a lower bound of it */
    double violation;                        /* of the laws of friction, as a slip (rad) or a part of the capacity */
    int tangent;                             /* whether there is one: */
    double turn[N], along[MOST_UNKNOWNS];    /* how far the bases turned to here, and z changed */
} Held;

typedef struct {
    Held held[2];
    Chain chain;
    double matrix[MOST_UNKNOWNS * STRIDE], compliance[MOST_UNKNOWNS * MOST_UNKNOWNS], mode[MOST_UNKNOWNS];
    double before[MOST_UNKNOWNS], free[MOST_UNKNOWNS], step[MOST_UNKNOWNS], last[MOST_UNKNOWNS];
    double theta[MOST_POINTS][N];
    Exchange exchange;
    Answer answer;
} Room;

typedef struct {
    const Tubes *tubes;
    Friction friction;
    Room *room;
    int margins; /* whether they are wanted of all states, not only where steps are long */
    int now;     /* which of the two is the state */
    double heat; /* J, that friction took since the first state */
} Motion;

/* --- where tubes rub ------------------------------------------------------------------------------------------------- */

/* Layout, unknowns and rows at translations; 0 where there is no room for them. */
static int begin_held(const Motion *m, const double *shift, Held *h) {
    const Friction *f = &m->friction;
    Unknowns *q = &h->q;
    if (!lay_out(m->tubes, shift, f, &h->layout)) return 0;
    if (!pose_unknowns(q, &h->layout, m->tubes, &FINE, 0)) return 0;
    h->rows = 0;
    for (int i = 0; i + 1 < N; i++)
        for (int x = 0; x < q->points; x++) {
            if (!(f->torque[i] + f->by_moment[i] > 0) || !h->layout.across[q->piece[x]].present[i + 1]) continue;
            int r = h->rows++;
            if (filled_up(q->size) + filled_up(r + 2) > MOST_UNKNOWNS) return 0;
            h->pair[r] = i;
            h->point[r] = x;
            h->inner[r] = q->first[i] + q->place[x][i];
            h->outer[r] = q->first[i + 1] + q->place[x][i + 1];
        }
    memcpy(h->shift, shift, sizeof h->shift);
    h->tangent = 0;
    return 1;
}

/* Largest torques of the rows in an increment: those of the bending moments at the rotations theta before it. */
static void press(const Friction *f, Held *h, double (*theta)[N]) {
    const Unknowns *q = &h->q;
    for (int r = 0; r < h->rows; r++) {
        int i = h->pair[r], x = h->point[r];
        double direction[N], none[2] = {0}, passed[N] = {0};
        for (int j = 0; j < N; j++) direction[j] = theta[x][j] + q->at[x].phase[j];
        const double *in[] = {direction, q->at[x].stiffness, q->at[x].moment, none};
        double *out[] = {passed};
        if (f->by_moment[i] > 0) passed_moment(in, out, 0, 0, 0);
        h->most[r] = fmax((f->torque[i] + f->by_moment[i] * passed[i]) * q->weight[x], LEAST_CAPACITY);
    }
}

/* x <- x + P' y: what torques y of the rows do to the unknowns. */
static void add_rows(const Held *h, const double *y, double *x) {
    double load[MOST_UNKNOWNS] = {0};
    const Unknowns *q = &h->q;
    for (int r = 0; r < h->rows; r++) {
        load[h->outer[r]] += y[r];
        load[h->inner[r]] -= y[r];
    }
    add_by_factor(q, load, x);
}

/* Energy and relative rotations at h->state.z. */
static void look(Held *h) {
    evaluate(&h->q, h->alpha, &h->state);
    for (int r = 0; r < h->rows; r++) {
        const double *theta = h->state.theta[h->point[r]];
        h->turned[r] = theta[h->pair[r] + 1] - theta[h->pair[r]];
    }
}

/* --- one increment --------------------------------------------------------------------------------------------------- */

/* Upper triangle of 1 + L' B V'' L, rows of length STRIDE: from the tip, the elements of tube i against all of tube j.
   All points further out see an element alike (`beyond`), so that they enter by a sum and one row: the products cost the
   square of the unknowns, not the cube, and less than the elimination that follows.
   Fours that have too much are laid over by what comes after them. */
ALWAYS_INLINE void vary(const Unknowns *q, const State *state, int k, double *h) {
    for (int i = 0; i < N; i++)
        for (int j = i; j < N; j++) {
            const double *nearer = q->beyond + q->first[j];
            double further = 0, outwards[MOST_UNKNOWNS]; /* of elements further out: B V'', and B V'' L of tube j */
            int count = q->count[j], from = count, to;
            for (int x = q->points - k; x >= 0; x -= k) {
                int a = q->place[x][i], c = q->place[x][j], both = a >= 0 && c >= 0;
                const double(*left)[WIDE] = (const double(*)[WIDE])q->block + q->first[i] + a;
                const double(*right)[WIDE] = (const double(*)[WIDE])q->block + q->first[j] + c;
                const double *beyond = q->beyond + q->first[i] + a;
                double value[MOST_DEGREE], sum = 0;
                for (int b = 0; b < k && both; b++)
                    sum += value[b] = q->weight[x + b] * state->slope[x + b][j * N + i];
                to = from;
                if (c >= 0) from = c;
                for (int r = 0; r < k && a >= 0; r++) {
                    double *row = h + (size_t)(q->first[i] + a + r) * STRIDE + q->first[j], all = beyond[r] * further;
                    Four here[WIDE / 4] = {{0}}; /* all that is read is written; compilers cannot know */
                    for (int w = 0; w < k && c >= 0; w += 4) EACH(OF(here[w / 4]) = all * FOUR(nearer + c + w));
                    for (int b = r; b < k && both; b++) {
                        double part = left[b][r] * value[b];
                        all += part;
                        for (int w = 0; w < k; w += 4) EACH(OF(here[w / 4]) += part * FOUR(right[b] + w));
                    }
                    for (int s = 0; s < from && i != j; s += 4) EACH(FOUR(row + s) = all * FOUR(nearer + s));
                    for (int w = 0; w < k && c >= 0; w += 4) EACH(FOUR(row + c + w) = OF(here[w / 4]));
                    for (int s = to; s < count; s += 4) EACH(FOUR(row + s) = beyond[r] * FOUR(outwards + s));
                }
                for (int w = 0; w < k && c >= 0; w += 4) {
                    Four here;
                    EACH(OF(here) = further * FOUR(nearer + c + w));
                    for (int b = 0; b < k && both; b++) EACH(OF(here) += value[b] * FOUR(right[b] + w));
                    for (int s = w; s < w + 4 && s < k; s++) outwards[c + s] = here[s - w];
                }
                further += sum;
            }
        }
    for (int r = 0; r < q->size; r++) h[(size_t)r * STRIDE + r] += 1;
}

static void second_variation(const Unknowns *q, const State *state, double *h) {
    if (q->tableau->degree == MOST_DEGREE)
        vary(q, state, MOST_DEGREE, h);
    else
        vary(q, state, COARSE_DEGREE, h);
}

/* The second-order model of the energy: (H P'; . 0) with H eliminated, which leaves its factor, and from it what the rows
   comply with. 0 where H is not positive definite. */
static int model_energy(const Held *h, Room *w) {
    const Unknowns *q = &h->q;
    int n = q->size, from = filled_up(n), whole = from + filled_up(h->rows);
    double *a = w->matrix;
    second_variation(q, &h->state, a);
    for (int r = 0; r < n; r++) memset(a + (size_t)r * STRIDE + n, 0, (whole - n) * sizeof(double));
    for (int r = n; r < whole; r++)
        for (int j = r; j < whole; j++) a[(size_t)r * STRIDE + j] = r == j && r < from;
    for (int r = 0; r < h->rows; r++)
        for (int side = 0; side < 2; side++) {
            int at = side ? h->outer[r] : h->inner[r], own = at - h->point[r] % q->tableau->degree;
            for (int k = q->first[h->pair[r] + side]; k <= at; k++)
                a[(size_t)k * STRIDE + from + r] += (side ? 1 : -1) * (k < own ? q->beyond[k] : q->block[at][k - own]);
        }
    if (!eliminate(a, from, whole, STRIDE)) return 0;
    for (int r = 0; r < h->rows; r++)
        for (int c = r; c < h->rows; c++)
            w->compliance[(size_t)r * h->rows + c] = w->compliance[(size_t)c * h->rows + r] =
                -a[(size_t)(from + r) * STRIDE + from + c];
    return 1;
}

/* What the rows would slip by without friction, by the gradient of now and the model, which may be of a step before. */
static void slip_freely(const Held *h, Room *w) {
    double turned[MOST_UNKNOWNS];
    const Unknowns *q = &h->q;
    for (int r = 0; r < q->size; r++) w->step[r] = -h->state.gradient[r];
    cholesky_solve(w->matrix, q->size, STRIDE, w->step);
    times_factor(q, w->step, turned);
    for (int r = 0; r < h->rows; r++) w->free[r] = h->turned[r] - w->before[r] + turned[h->outer[r]] - turned[h->inner[r]];
}

/* 1 if the state satisfies the laws of friction to HONEST. */
static int honest(Held *h, const double *before) {
    h->violation = 0;
    for (int r = 0; r < h->rows; r++) {
        double slip = h->turned[r] - before[r], wrong = h->sign[r] ? -slip * h->sign[r] : fabs(slip);
        double over = fabs(h->torque[r]) / h->most[r] - 1;
        if (!(wrong <= HONEST) || !(over <= HONEST)) return 0;
        h->violation = fmax(h->violation, fmax(wrong, over));
    }
    return 1;
}

/* The state near h->state.z, from relative rotations w->before; `guess` is 1 if h->sign is a guess. */
static int increment(Held *h, int guess, Room *w) {
    double last = INFINITY, contraction = 0;
    signed char kept[MOST_UNKNOWNS];
    const Unknowns *q = &h->q;
    look(h);
    for (int k = 0; k < FRICTION_ITERATIONS; k++) {
        double size, load[MOST_UNKNOWNS];
        if (last > CHORD_STEP && !model_energy(h, w)) return DECLINED;
        slip_freely(h, w);
        for (int r = 0; r < h->rows && !guess; r++) h->sign[r] = (w->free[r] > 0) - (w->free[r] < 0);
        memcpy(kept, h->sign, h->rows);
        Sticking s = {h->rows, w->compliance, w->free, h->most, h->torque, h->sign};
        if (!stick_or_slip(&s, &w->exchange)) return DECLINED;
        for (int r = 0; r < h->rows; r++) load[r] = -h->torque[r];
        for (int r = 0; r < q->size; r++) w->step[r] = -h->state.gradient[r];
        add_rows(h, load, w->step);
        cholesky_solve(w->matrix, q->size, STRIDE, w->step);
        size = turn_of(q, w->step);
        if (!(size <= 3.14)) return DECLINED;
        for (int r = 0; r < q->size; r++) h->state.z[r] += w->step[r];
        look(h);
        if (size <= LAST_STEP) {
            memcpy(w->step, h->state.gradient, q->size * sizeof(double));
            add_rows(h, h->torque, w->step);
            if (size <= ROUND_OFF || turn_of(q, w->step) <= ROUND_OFF)
                return honest(h, w->before) && contraction <= LARGEST_RATIO ? SOLVED : DECLINED;
        } else if (k && !memcmp(kept, h->sign, h->rows))
            contraction = fmax(contraction, size / last);
        last = size;
        guess = 1;
    }
    return DECLINED;
}

/* Torsion along the arm, and where it is wanted the margin to 1e-5; 0 where the state is not stable without friction. */
static int settle(Held *h, int wanted, Room *w) {
    const Unknowns *q = &h->q;
    integrate(q, h->alpha, &h->state, &h->arm);
    for (int r = 0; r < h->rows; r++) {
        int x = h->point[r], i = h->pair[r], at = x % q->tableau->degree * N;
        double *m = h->arm.moment[q->piece[x]] + at, per_length = h->torque[r] / q->weight[x];
        m[i + 1] += per_length;
        m[i] -= per_length;
    }
    turn_along(q, h->alpha, NULL, &h->arm);
    h->margin = 1;
    if (!q->size) return 1;
    h->margin = 0;
    if (!factor_variation(q, &h->state, 1, &w->chain)) return 0;
    if (!wanted) return 1;
    anywhere(w->mode, q->size);
    h->margin = fmin(1, least_eigenvalue((Factored){q, &w->chain, NULL, NULL}, ROUGH_ERROR, HARDLY_SOFTER, 0, w->mode));
    return h->margin > 0;
}

/* --- from one to the next -------------------------------------------------------------------------------------------- */

/* theta of a tube at arc length s, constant beyond the tip, behind the plate by the torque of the transmission. */
static double theta_at(const Held *h, int tube, double s) {
    const Layout *l = &h->layout;
    double inside = fmax(s, 0), legendre[MOST_DEGREE + 2] = {1}, once[MOST_DEGREE] = {0}, twice[MOST_DEGREE] = {0};
    double behind = 0;
    if (s < 0) {
        double reach = compliant(h->q.tubes->pieces, tube, fmax(l->transmission[tube] + s, 0));
        behind = (reach - l->held[tube]) * h->arm.torque[0][tube];
    }
    int p = 0, degree = h->q.tableau->degree;
    if (!l->pieces) return h->arm.rotation[0][tube] + behind; /* an arm of length zero */
    while (p + 1 < l->pieces && l->start[p + 1] <= inside) p++;
    double along = l->length[p], x = fmin(fmax((inside - l->start[p]) / along, 0), 1), u = legendre[1] = 2 * x - 1;
    for (int j = 2; j < degree + 2; j++) legendre[j] = ((2 * j - 1) * u * legendre[j - 1] - (j - 1) * legendre[j - 2]) / j;
    for (int k = 0; k < degree; k++) {
        for (int j = 0; j < degree + 1; j++) once[k] += legendre[j] * ONCE_LEGENDRE[j * degree + k];
        for (int j = 0; j < degree + 2; j++) twice[k] += legendre[j] * TWICE_LEGENDRE[j * degree + k];
    }
    return rotation_at(&h->q, &h->arm, p, tube, x, once, twice) + behind;
}

/* The state at other joint values: NULL where the step is too long. */
static Held *step_held(Motion *m, const double *alpha, const double *shift) {
    Room *w = m->room;
    Held *old = &w->held[m->now], *h = old;
    double turn[N], moved[N], straight = 0, size = 0, other = 0, far = 0, limit = LONGEST_TWIST(old->margin);
    int same = 1, guess = 0;
    for (int i = 0; i < N; i++) {
        turn[i] = alpha[i] - old->alpha[i];
        moved[i] = shift[i] - old->shift[i];
        same &= moved[i] == 0;
    }
    if (same) {
        memcpy(w->before, h->turned, h->rows * sizeof(double));
        memcpy(w->theta, h->state.theta, h->q.points * sizeof w->theta[0]);
        memcpy(w->last, h->state.z, h->q.size * sizeof(double));
        for (int i = 0; i < N && h->tangent; i++) {
            straight += turn[i] * h->turn[i];
            size += h->turn[i] * h->turn[i];
            other += turn[i] * turn[i];
        }
        if (straight > ONWARD * sqrt(size * other) && size * other > 0)
            for (int r = 0; r < h->q.size; r++) h->state.z[r] += h->along[r] * (straight / size);
        guess = 1;
    } else {
        h = &w->held[!m->now];
        if (!begin_held(m, shift, h)) return NULL;
        if ((guess = h->rows == old->rows)) memcpy(h->sign, old->sign, h->rows); /* most go on as they did */
        for (int x = 0; x < h->q.points; x++)
            for (int i = 0; i < N; i++) {
                w->theta[x][i] = theta_at(old, i, h->q.s[x]);
                h->state.theta[x][i] = w->theta[x][i] + turn[i];
            }
        for (int r = 0; r < h->rows; r++) {
            double s = h->q.s[h->point[r]];
            int i = h->pair[r];
            w->before[r] = theta_at(old, i + 1, s - moved[i + 1]) - theta_at(old, i, s - moved[i]);
        }
        to_unknowns(&h->q, alpha, h->state.theta, h->state.z);
    }
    memcpy(h->alpha, alpha, sizeof h->alpha);
    press(&m->friction, h, w->theta);
    if (increment(h, guess, w) != SOLVED) return NULL;
    for (int i = 0; i < N; i++)
        for (int a = h->q.first[i]; a < h->q.first[i] + h->q.count[i]; a++) {
            int x = h->q.point[a];
            far = fmax(far, fabs(h->state.theta[x][i] - w->theta[x][i] - turn[i]));
        }
    /* Margins cost as much as a step: that of the state before is found only where the step is long for the worst one. */
    if (far > limit && h != old && old->margin == 0 && settle(old, 1, w)) limit = LONGEST_TWIST(old->margin);
    if (!(far <= limit) || !settle(h, m->margins || far > LONG * SOFT_TWIST, w)) return NULL;
    if (same) {
        for (int r = 0; r < h->q.size; r++) h->along[r] = h->state.z[r] - w->last[r];
        memcpy(h->turn, turn, sizeof h->turn);
        h->tangent = 1;
    }
    for (int r = 0; r < h->rows; r++)
        if (h->sign[r]) m->heat += h->most[r] * fabs(h->turned[r] - w->before[r]);
    m->now = h - w->held;
    return h;
}

/* --- what Python calls ----------------------------------------------------------------------------------------------- */

CASADI_SYMBOL_EXPORT size_t workspace_size(void) { return sizeof(Room); }
CASADI_SYMBOL_EXPORT size_t answer_size(void) { return sizeof(Answer); }

/* Rows 1 ... of joint values (count, N) from the state of row 0. Returns how many there are, row 0 too, before a step is too
   long or the state is lost. A row of z, torque and sign (count, MOST_UNKNOWNS) holds the unknowns of a state, and its rows of friction;
   `out` (count, 3 stations + 9 + N + 4) gets stations `behind` the tip, the tip's frame by rows, rotations of the tubes
   there, margin (0 where `sizes` says that it is not wanted), length, the heat since row 0, and the violation of the laws
   of friction. -1 where the state is not one of these tubes. */
CASADI_SYMBOL_EXPORT long long friction_motion(const Tubes *tubes, const double *friction, double pieces, long long count,
                                   const double *alpha, const double *shift, const long long *sizes, double *z,
                                   double *torque, double *capacity, signed char *sign, const double *behind, double *out,
                                   Room *w) {
    Motion m = {tubes, {friction, friction + N - 1, pieces}, w, (int)sizes[3], 0, 0};
    Held *h = &w->held[0];
    int stations = (int)sizes[2], width = 3 * stations + 9 + N + 4;
    if (!begin_held(&m, shift, h) || h->q.size != sizes[0] || h->rows != sizes[1]) return -1;
    memcpy(h->alpha, alpha, sizeof h->alpha);
    memcpy(h->state.z, z, h->q.size * sizeof(double));
    memcpy(h->torque, torque, h->rows * sizeof(double));
    memcpy(h->sign, sign, h->rows);
    look(h);
    if (!settle(h, 1, w)) return 1;
    for (long long k = 1; k < count; k++) {
        h = step_held(&m, alpha + k * N, shift + k * N);
        if (!h) return k;
        Answer *a = &w->answer;
        a->margin = h->margin;
        a->energy = h->state.energy;
        finish(&h->q, &h->state, &h->arm, a);
        int tip = (int)a->pieces * STEPS;
        double *row = out + k * width;
        for (int j = 0; j < stations; j++) place_on(a, a->arc_length[tip] - behind[j], row + 3 * j);
        row += 3 * stations;
        memcpy(row, a->frame[tip], 9 * sizeof(double));
        memcpy(row + 9, a->rotation[tip], N * sizeof(double));
        row[9 + N] = h->margin;
        row[10 + N] = a->arc_length[tip];
        row[11 + N] = m.heat;
        row[12 + N] = h->violation;
        memcpy(z + k * MOST_UNKNOWNS, h->state.z, h->q.size * sizeof(double));
        memcpy(torque + k * MOST_UNKNOWNS, h->torque, h->rows * sizeof(double));
        memcpy(capacity + k * MOST_UNKNOWNS, h->most, h->rows * sizeof(double));
        memcpy(sign + k * MOST_UNKNOWNS, h->sign, h->rows);
    }
    return count;
}
