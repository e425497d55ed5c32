
/* --- how far all tubes of a loaded arm may turn before anything snaps --------------------------------------------- */

/* What stability/loaded_distance.py proves, with its symbols, and stability/boxes.py searches. Rows are angles of pairs of
   curved tubes, rotations of these tubes, and bending q; boxes are (-low, high) of every row, for each part of the cube of
   turns side by side. */

#define MOST_PAIRS (N * (N - 1) / 2)
#define MOST_CHANGES (160 * N) /* rows at most: shipped robots have up to 130 for each tube */
#define PARTS (1 << N)
#define MOST_CHANGE 3.         /* rad, of an angle in a box: below pi, h has one extremum beside 0 in it */
#define SPARE 1e-10            /* of a box beyond its image */
#define LEAST_RISE 1e-9        /* of the least eigenvalue above 0: more than round-off */
#define SWEEPS 2000            /* images of a box at most */
#define ROOM_LEFT 1.3          /* by how much more than the steps that are left a box takes */
#define SHRINKS 8              /* images of a box between two checks of the second variation in it */
#define HALF_TURN 3.141592653589793
#define FIRST_TURN 0.1         /* rad, that a search begins with */
#define SMALLEST 1e-6          /* part of the largest turn: a smaller one counts as none */

typedef double Boxes[2][MOST_CHANGES][PARTS];

/* h(x) = sine (1 - cos x) + cosine (x - sin x), with its extremum beside 0. */
typedef struct {
    double sine, cosine, extremum, at_extremum;
} Bend;

static double bend_at(const Bend *h, double x) { return h->sine * (1 - cos(x)) + h->cosine * (x - sin(x)); }

static Bend bend_of(double sine, double cosine) {
    Bend out = {sine, cosine, remainder(-2 * atan2(sine, cosine), 2 * HALF_TURN), 0};
    out.at_extremum = bend_at(&out, out.extremum);
    return out;
}

typedef struct {
    int points, degree, pairs, tubes, rows;
    int point[MOST_CHANGES], tube[MOST_CHANGES], pair[MOST_CHANGES][2]; /* of curved tubes; of pairs their numbers */
    Bend of_pair[MOST_CHANGES], of_tube[MOST_CHANGES]; /* of the angle; of the moment across and along a */
    double psi[MOST_CHANGES], w[MOST_CHANGES], bend[MOST_CHANGES]; /* bend: |a| / K */
    double guess[MOST_CHANGES], bend_guess[MOST_POINTS];                  /* of the softest variation */
    double moment[MOST_POINTS], thrust[MOST_POINTS];                      /* |m|; B |n| */
    double defect[MOST_CHANGES], J[N][MOST_CHANGES], G[MOST_CHANGES][MOST_CHANGES];
    Boxes start, box, image, other, force; /* the box y, its trial, and work space */
    Softening softening;
} Turning;

/* Bounds of a part: 2 sin(|eta| / 2); V, M, and the part of M that is not linear. */
typedef struct {
    double turned[MOST_CHANGES], swept[MOST_POINTS], change[MOST_POINTS], rest[MOST_POINTS];
} Bounds;

/* out <- the sums of B f over the points up to the end of the element of each. */
static void sum_up(const Stage *s, const double *f, double *out) {
    double sum = 0;
    for (int x = 0; x < s->points; x += s->degree) {
        for (int a = x; a < x + s->degree; a++) sum += s->weight[a] * f[a];
        for (int a = x; a < x + s->degree; a++) out[a] = sum;
    }
}

/* out <- the sums of f over the points from the beginning of the element of each on. */
static void sum_beyond(const Stage *s, const double *f, double *out) {
    double sum = 0;
    for (int x = s->points - s->degree; x >= 0; x -= s->degree) {
        for (int a = x; a < x + s->degree; a++) sum += f[a];
        for (int a = x; a < x + s->degree; a++) out[a] = sum;
    }
}

/* All rows of what step->theta and step->bend change, times `sign`. */
static void rows_of(const Stage *s, const Turning *t, const Step *step, double sign, double *out) {
    for (int k = 0; k < t->tubes; k++) out[t->pairs + k] = sign * step->theta[t->point[k]][t->tube[k]];
    for (int p = 0; p < t->pairs; p++) out[p] = out[t->pairs + t->pair[p][0]] - out[t->pairs + t->pair[p][1]];
    for (int x = 0; x < t->points; x++)
        for (int j = 0; j < 2; j++)
            out[t->pairs + t->tubes + 2 * x + j] = sign * change_of_q(s, x, j, step->theta[x], step->bend[x][j]);
}

/* The curved tubes of a solved state and their pairs; 0 where there is no room. */
static int find_curved(const Stage *s, const State *state, Turning *t) {
    const Problem *p = s->problem;
    double before[N];
    t->points = s->points, t->degree = s->degree, t->pairs = t->tubes = 0;
    for (int i = 0; i < N; i++) before[i] = p->held[i]; /* compliance up to the piece */
    for (int x = 0; x < s->points; x++) {
        const Piece *piece = &s->piece[x / s->degree];
        double q[2] = {state->q[x][0], state->q[x][1]}, per = 1 / (s->soft[x] * s->weight[x]);
        int first = t->tubes;
        t->moment[x] = per * sqrt(dot(q, q, 2));
        t->thrust[x] = s->weight[x] * sqrt(dot(p->force + 3 * x, p->force + 3 * x, 3));
        for (int i = 0; i < N; i++) {
            int k = t->tubes, a = x % s->degree;
            if (p->at[x].moment[i] == 0 || piece->count[i] < s->degree) continue;
            if (k + t->pairs + MOST_PAIRS + 2 * s->points >= MOST_CHANGES) return 0;
            const double *turned = state->turned[x][i], towards[2] = {turned[1], -turned[0]};
            t->tubes++;
            t->point[k] = x, t->tube[k] = i;
            t->bend[k] = sqrt(dot(turned, turned, 2));
            t->of_tube[k] = bend_of(per * dot(turned, q, 2) / t->bend[k], -per * dot(towards, q, 2) / t->bend[k]);
            t->guess[k] = sqrt(before[i] + dot(piece->turn[i][a], piece->turn[i][a], s->degree));
            for (int j = first; j < k; j++) {
                int o = t->tube[j], r = t->pairs++;
                /* A tube curved backwards is one turned by half. */
                double half = (p->at[x].moment[i] < 0) != (p->at[x].moment[o] < 0) ? HALF_TURN : 0;
                t->pair[r][0] = j, t->pair[r][1] = k;
                t->psi[r] = state->theta[x][o] + p->at[x].phase[o] - state->theta[x][i] - p->at[x].phase[i] + half;
                t->of_pair[r] = bend_of(sin(t->psi[r]), cos(t->psi[r]));
                t->w[r] = t->bend[j] * t->bend[k] / (s->soft[x] * s->soft[x]);
            }
        }
        if (x % s->degree == s->degree - 1)
            for (int i = 0; i < N; i++) before[i] += dot(piece->passed[i], piece->passed[i], piece->count[i]);
    }
    t->rows = t->pairs + t->tubes + 2 * t->points;
    double size = 0, bent[MOST_POINTS] = {0}, curved = 0;
    for (int k = 0; k < t->tubes; k++) size += t->guess[k] * t->guess[k];
    for (int k = 0; k < t->tubes; k++) {
        t->guess[k] += 1e-9 * sqrt(size);
        bent[t->point[k]] += t->bend[k] * t->guess[k];
    }
    for (int x = 0; x < t->points; x++) curved = fmax(curved, bent[x]);
    for (int x = 0; x < t->points; x++) t->bend_guess[x] = curved / s->soft[x];
    return 1;
}

/* What one unit of a row's force does: step has minus H^-1 of it. */
static void push_row(const Stage *s, const Turning *t, int row, Step *step) {
    Functional *by = &step->by;
    memset(by, 0, sizeof *by);
    for (int side = 0; side < 2; side++) {
        int k = row < t->pairs ? t->pair[row][side] : row - t->pairs;
        if (row < t->pairs || (!side && k < t->tubes)) by->theta[t->point[k]][t->tube[k]] = side ? -1 : 1;
    }
    int q = row - t->pairs - t->tubes, x = q / 2, j = q % 2;
    if (q >= 0) {
        by->bend[x][j] = 1;
        for (int i = 0; i < N; i++) by->theta[x][i] = -s->gain[x][i][j];
    }
    sweep_back(s, by, step);
    sweep_forth(s, step, 0);
}

/* The rows of a state that was solved, and what follows from it; 0 where there is no room, or it is not stable. */
static int find_turning(Stage *s, State *state, const double *alpha, Step *step, Step *other, Turning *t) {
    double turned[N];
    evaluate(s, state, 1);
    if (!find_curved(s, state, t) || !factorise(s, state, 1, 1)) return 0;
    newton_step(s, state, alpha, 1, step, 0); /* linear in alpha, so that its differences are derivatives */
    for (int k = 0; k < N; k++) {
        memcpy(turned, alpha, sizeof turned);
        turned[k] += 1;
        newton_step(s, state, turned, 1, other, 0);
        for (int x = 0; x < s->points; x++) {
            for (int i = 0; i < N; i++) other->theta[x][i] -= step->theta[x][i];
            for (int j = 0; j < 2; j++) other->bend[x][j] -= step->bend[x][j];
        }
        rows_of(s, t, other, 1, t->J[k]);
    }
    for (int x = 0; x < s->points; x++)
        for (int i = 0; i < N; i++) step->theta[x][i] -= state->theta[x][i];
    rows_of(s, t, step, 1, t->defect);
    for (int r = 0; r < t->rows; r++) t->defect[r] = fabs(t->defect[r]);
    for (int r = 0; r < t->rows; r++) {
        push_row(s, t, r, step);
        rows_of(s, t, step, -1, t->G[r]);
    }
    return 1;
}

/* Bounds in a part of boxes. */
static void bound_part(const Stage *s, const Turning *t, Boxes u, int part, Bounds *out) {
    double v[MOST_POINTS] = {0}, v2[MOST_POINTS] = {0}, pulled[MOST_POINTS], rest[MOST_POINTS], swept2[MOST_POINTS];
    for (int k = 0; k < t->tubes; k++) {
        int row = t->pairs + k, x = t->point[k];
        double most = fmin(fmax(u[0][row][part], u[1][row][part]), HALF_TURN);
        out->turned[k] = 2 * sin(most / 2);
        v[x] += t->bend[k] * out->turned[k];
        v2[x] += t->bend[k] * hypot(1 - cos(most), most - sin(most));
    }
    for (int x = 0; x < t->points; x++) {
        int row = t->pairs + t->tubes + 2 * x;
        v[x] += s->soft[x] * hypot(fmax(u[0][row][part], u[1][row][part]), fmax(u[0][row + 1][part], u[1][row + 1][part]));
    }
    sum_up(s, v, out->swept);
    sum_up(s, v2, swept2);
    for (int x = 0; x < t->points; x++) {
        pulled[x] = t->thrust[x] * out->swept[x];
        rest[x] = t->thrust[x] * (swept2[x] + out->swept[x] * out->swept[x] / 2);
    }
    sum_beyond(s, pulled, out->change);
    sum_beyond(s, rest, out->rest);
}

/* Range of h = sine (1 - cos x) + cosine (x - sin x) in a box within -pi and pi: at its ends, 0, and the extremum beside 0. */
static void range_of_bend(const Bend *h, double low, double high, double *least, double *most) {
    double first = bend_at(h, low), last = bend_at(h, high);
    double other = low <= h->extremum && h->extremum <= high ? h->at_extremum : 0;
    *least = fmin(fmin(first, last), fmin(other, 0)), *most = fmax(fmax(first, last), fmax(other, 0));
}

/* Least cosine of the angles between two. */
static double least_cosine(double low, double high) {
    double turn = 2 * HALF_TURN;
    return floor((high - HALF_TURN) / turn) > floor((low - HALF_TURN) / turn) ? -1 : fmin(cos(low), cos(high));
}

/* Boxes that hold the images of boxes u, those of J d being wider than t->start by `spare`; whether u holds them. */
static int map_boxes(const Stage *s, Turning *t, double spare, Boxes u, Boxes out) {
    Bounds bounds;
    int holds = 1;
    for (int part = 0; part < PARTS; part++) {
        bound_part(s, t, u, part, &bounds);
        for (int p = 0; p < t->pairs; p++) {
            double least, most;
            range_of_bend(t->of_pair + p, -u[0][p][part], u[1][p][part], &least, &most);
            t->force[0][p][part] = -t->w[p] * least, t->force[1][p][part] = t->w[p] * most;
        }
        for (int k = 0; k < t->tubes; k++) {
            int row = t->pairs + k, x = t->point[k];
            double least, most, unknown = bounds.rest[x] + bounds.turned[k] * bounds.change[x], scale = s->weight[x] * t->bend[k];
            range_of_bend(t->of_tube + k, -u[0][row][part], u[1][row][part], &least, &most);
            t->force[0][row][part] = scale * (most + unknown), t->force[1][row][part] = scale * (unknown - least); /* of -R */
        }
        for (int x = 0; x < t->points; x++)
            for (int j = 0; j < 2; j++)
                for (int side = 0; side < 2; side++)
                    t->force[side][t->pairs + t->tubes + 2 * x + j][part] = s->weight[x] * s->soft[x] * bounds.rest[x];
    }
    for (int r = 0; r < t->rows; r++)
        for (int part = 0; part < PARTS; part++) { /* as middle and half width */
            double low = t->force[0][r][part], high = t->force[1][r][part];
            t->force[0][r][part] = (high - low) / 2, t->force[1][r][part] = (high + low) / 2;
        }
    for (int p = 0; p < t->rows; p++) {
        double middle[PARTS] = {0}, half[PARTS] = {0};
        for (int r = 0; r < t->rows; r++) {
            double G = t->G[p][r], size = fabs(G);
            for (int part = 0; part < PARTS; part++) {
                middle[part] += G * t->force[0][r][part];
                half[part] += size * t->force[1][r][part];
            }
        }
        for (int part = 0; part < PARTS; part++) {
            out[0][p][part] = t->start[0][p][part] + spare + half[part] - middle[part];
            out[1][p][part] = t->start[1][p][part] + spare + half[part] + middle[part];
            holds &= out[0][p][part] <= u[0][p][part] && out[1][p][part] <= u[1][p][part];
        }
    }
    return holds;
}

/* Whether the second variation is positive in a part of boxes. */
static int convex_in(Stage *s, const State *state, Turning *t, Boxes u, int part) {
    Bounds bounds;
    Softening *by = &t->softening;
    double v0[MOST_POINTS], v1[MOST_POINTS] = {0}, phi0[MOST_POINTS], phi1[MOST_POINTS], pull0[MOST_POINTS], pull1[MOST_POINTS];
    bound_part(s, t, u, part, &bounds);
    memset(by, 0, sizeof *by);
    for (int p = 0; p < t->pairs; p++) {
        int x = t->point[t->pair[p][0]], i = t->tube[t->pair[p][0]], j = t->tube[t->pair[p][1]];
        double weaker = t->w[p] * (least_cosine(t->psi[p] - u[0][p][part], t->psi[p] + u[1][p][part]) - t->of_pair[p].cosine);
        by->theta[x][i][i] += weaker, by->theta[x][j][j] += weaker;
        by->theta[x][i][j] -= weaker, by->theta[x][j][i] -= weaker;
    }
    /* Phi_0 and Phi_1 of the guess, then the gradient of their form. */
    for (int x = 0; x < t->points; x++) v0[x] = s->soft[x] * t->bend_guess[x];
    for (int k = 0; k < t->tubes; k++) {
        v0[t->point[k]] += t->bend[k] * t->guess[k];
        v1[t->point[k]] += t->bend[k] * bounds.turned[k] * t->guess[k];
    }
    sum_up(s, v0, phi0);
    sum_up(s, v1, phi1);
    for (int x = 0; x < t->points; x++) {
        pull0[x] = t->thrust[x] * (bounds.swept[x] * phi0[x] + phi1[x]);
        pull1[x] = t->thrust[x] * (phi0[x] + phi1[x]);
    }
    sum_beyond(s, pull0, phi0);
    sum_beyond(s, pull1, phi1);
    for (int k = 0; k < t->tubes; k++) {
        int x = t->point[k], i = t->tube[k];
        double B = s->weight[x], softer = B * t->bend[k] * (bounds.turned[k] * t->moment[x] + bounds.change[x]);
        by->theta[x][i][i] -= softer + t->bend[k] * B * (phi0[x] + bounds.turned[k] * phi1[x]) / t->guess[k];
    }
    for (int x = 0; x < t->points; x++) by->bend[x] = -s->soft[x] * s->weight[x] * phi0[x] / t->bend_guess[x];
    return factorise_softened(s, state, 1, 1 - LEAST_RISE, by);
}

#define EACH_SIDE(of)                                          \
    for (int side = 0; side < 2; side++)                       \
        for (int r = 0; r < t->rows; r++)                      \
            for (int part = 0; part < PARTS; part++) {         \
                of;                                            \
            }

/* The largest number of u, less that of `from` where it is not NULL. */
static double largest_of_boxes(const Turning *t, Boxes u, double (*from)[MOST_CHANGES][PARTS]) {
    double out = 0;
    EACH_SIDE(out = fmax(out, u[side][r][part] - (from ? from[side][r][part] : 0)))
    return out;
}

/* t->box around the least fixed points, by images from below of starts a little wider. Their steps shrink by a ratio; boxes take the
   sum of those that are left, with a reserve. 0 where none is found. */
static int close_boxes(const Stage *s, Turning *t) {
    double size = INFINITY;
    memcpy(t->image, t->start, sizeof t->image);
    for (int sweep = 0; sweep < SWEEPS; sweep++) {
        double before = size, left;
        map_boxes(s, t, SPARE, t->image, t->box);
        if (largest_of_boxes(t, t->box, NULL) > MOST_CHANGE) return 0;
        size = largest_of_boxes(t, t->box, t->image);
        left = size > 0 ? ROOM_LEFT / fmax(before / size - 1, 1e-3) : 0;
        EACH_SIDE(double image = t->box[side][r][part];
                  t->box[side][r][part] += left * (image - t->image[side][r][part]);
                  t->image[side][r][part] = image)
        if (largest_of_boxes(t, t->box, NULL) <= MOST_CHANGE && map_boxes(s, t, 0, t->box, t->other)) return 1;
    }
    return 0;
}

/* Whether turns of all tubes, each by at most r either way, are proved to cause no snap. */
static int proves_turn(Stage *s, const State *state, Turning *t, double r) {
    for (int row = 0; row < t->rows; row++)
        for (int part = 0; part < PARTS; part++) {
            double low = 0, high = 0;
            for (int k = 0; k < N; k++) {
                double by = (part >> k & 1 ? r : -r) * t->J[k][row];
                low -= fmin(by, 0), high += fmax(by, 0);
            }
            t->start[0][row][part] = low + t->defect[row], t->start[1][row][part] = high + t->defect[row];
        }
    if (!close_boxes(s, t)) return 0;
    while (largest_of_boxes(t, t->box, NULL) <= MOST_CHANGE && map_boxes(s, t, 0, t->box, t->image)) {
        int part = 0;
        while (part < PARTS && convex_in(s, state, t, t->box, part)) part++;
        if (part == PARTS) return 1;
        for (int k = 0; k < SHRINKS; k++) { /* to images, which hold their own */
            map_boxes(s, t, 0, t->image, t->other);
            memcpy(t->image, t->other, sizeof t->image);
        }
        if (largest_of_boxes(t, t->box, t->image) < SPARE) return 0;
        memcpy(t->box, t->image, sizeof t->box);
    }
    return 0;
}

/* The largest such r up to `most`, to a relative precision. */
static double largest_turn_of(Stage *s, const State *state, Turning *t, double most, double precision) {
    double proved = 0, refused = fmin(most, HALF_TURN), limit = refused, r = fmin(FIRST_TURN, refused / 2);
    if (most < HALF_TURN && proves_turn(s, state, t, most)) return most;
    while (refused - proved > precision * refused && refused > SMALLEST * limit) {
        *(proves_turn(s, state, t, r) ? &proved : &refused) = r;
        r = refused < limit ? (proved + refused) / 2 : fmin(2 * proved, (proved + refused) / 2);
    }
    return proved;
}
