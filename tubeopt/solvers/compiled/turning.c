/* How far all tubes may turn and slide from a solved equilibrium of concentric tubes before anything snaps: what
   stability/snap_distance.py proves, with its symbols. Boxes are (-low, high) of every coupling. */

#define MOST_COUPLINGS 192
#define SECTORS (N < 2 ? 0 : N < 3 ? 2 : N < 4 ? 6 : 24) /* n!, of up to four tubes */
#define MOST_CHANGE 3.  /* rad, of an angle in a box: below pi, h has one extremum beside 0 in it */
#define SPARE 1e-10     /* rad, of a box beyond its image */
#define ROUNDING 1e-12  /* rad, above that of an image */
#define LEAST_RISE 1e-9 /* of the least eigenvalue of H above 0: more than round-off */
#define SETTLED 1e-16   /* rad^2, of a step after which a box does not shrink */
#define SWEEPS 240      /* images of a box at most */
#define ROOM_LEFT 1.3   /* by how much more than the steps that are left a box takes */
#define HALF_TURN 3.141592653589793
#define FIRST_TURN 0.1 /* rad, that a search begins with */
#define SMALLEST 1e-6  /* part of the largest motion: a smaller one counts as none */

typedef struct {
    const Unknowns *q, *softest; /* with the longest transmissions */
    State *trial;
    Chain *h; /* room for a factorised H */
    int count, slides, point[MOST_COUPLINGS], tube[MOST_COUPLINGS][2];
    double psi[MOST_COUPLINGS], sine[MOST_COUPLINGS], cosine[MOST_COUPLINGS], w[MOST_COUPLINGS];
    double weakest[MOST_COUPLINGS], strongest[MOST_COUPLINGS]; /* w during slides */
    double loosened[N]; /* turn of the base per torque after the whole slide, rad/(N m) */
    double extremum[MOST_COUPLINGS], at_extremum[MOST_COUPLINGS], spare[MOST_COUPLINGS];
    double G[MOST_COUPLINGS][MOST_COUPLINGS], J[N][MOST_COUPLINGS];
} Couplings;

typedef double Box[2][MOST_COUPLINGS];

static double h_at(const Couplings *c, int p, double x) { return c->sine[p] * (1 - cos(x)) + c->cosine[p] * (x - sin(x)); }

/* Entry (p, k) of D. */
static int incidence(const Couplings *c, int p, int k) { return (c->tube[p][0] == k) - (c->tube[p][1] == k); }

/* One more coupling between tubes i and j at point x, at angle psi; 0 where there is no room. */
static int add_coupling(Couplings *c, int x, int i, int j, double psi, double w) {
    int p = c->count;
    if (p == MOST_COUPLINGS) return 0;
    c->count++;
    c->point[p] = x, c->tube[p][0] = i, c->tube[p][1] = j;
    c->psi[p] = psi, c->w[p] = c->weakest[p] = c->strongest[p] = w;
    return 1;
}

/* H of couplings with these factors, with `diagonal` in place of 1, factorised in c->h; 0 where it is not positive. */
static int vary_couplings(const Couplings *c, const Unknowns *q, const double *factor, double diagonal) {
    State *trial = c->trial;
    memset(trial->slope, 0, q->points * sizeof trial->slope[0]);
    for (int p = 0; p < c->count; p++) {
        int x = c->point[p], i = c->tube[p][0], j = c->tube[p][1];
        double part = factor[p] / q->weight[x], *slope = trial->slope[x];
        slope[i * N + i] += part, slope[j * N + j] += part;
        slope[i * N + j] -= part, slope[j * N + i] -= part;
    }
    return factor_variation(q, trial, diagonal, c->h);
}

/* out <- A H^-1 g, with H factorised. */
static void answer_of(const Couplings *c, double *g, double *out) {
    double turned[MOST_UNKNOWNS];
    const Unknowns *q = c->q;
    solve_variation(q, c->h, g);
    times_factor(q, g, turned);
    for (int p = 0; p < c->count; p++) {
        int x = c->point[p], i = c->tube[p][0], j = c->tube[p][1];
        out[p] = turned[q->first[i] + q->place[x][i]] - turned[q->first[j] + q->place[x][j]];
    }
}

/* g <- g + A' f. */
static void add_pulls(const Couplings *c, const double *f, double *g) {
    double pull[MOST_UNKNOWNS] = {0};
    const Unknowns *q = c->q;
    for (int p = 0; p < c->count; p++) {
        int x = c->point[p], i = c->tube[p][0], j = c->tube[p][1];
        pull[q->first[i] + q->place[x][i]] += f[p];
        pull[q->first[j] + q->place[x][j]] -= f[p];
    }
    add_by_factor(q, pull, g);
}

/* What follows from the angles, with H factorised and the gradient g that is left. */
static void answer_all(Couplings *c, double *g) {
    for (int p = 0; p < c->count; p++) {
        c->sine[p] = sin(c->psi[p]), c->cosine[p] = cos(c->psi[p]);
        c->extremum[p] = remainder(-2 * c->psi[p], 2 * HALF_TURN);
        c->at_extremum[p] = h_at(c, p, c->extremum[p]);
    }
    answer_of(c, g, c->spare);
    for (int p = 0; p < c->count; p++) c->spare[p] = fabs(c->spare[p]) + ROUNDING;
    for (int p = 0; p < c->count; p++) {
        double unit[MOST_COUPLINGS] = {0};
        unit[p] = 1;
        memset(g, 0, MOST_UNKNOWNS * sizeof *g);
        add_pulls(c, unit, g);
        answer_of(c, g, c->G[p]);
    }
    for (int p = 0; p < c->count; p++)
        for (int k = 0; k < N; k++) {
            c->J[k][p] = incidence(c, p, k);
            for (int r = 0; r < c->count; r++) c->J[k][p] -= c->G[p][r] * c->w[r] * c->cosine[r] * incidence(c, r, k);
        }
}

/* The couplings of a solved state; 0 where there are too many, or where it is not stable. */
static int find_couplings(const Unknowns *q, const State *state, State *trial, Chain *h, Couplings *c) {
    double g[MOST_UNKNOWNS];
    c->q = c->softest = q, c->trial = trial, c->h = h, c->count = c->slides = 0;
    if (N > 4) return 0; /* 120 sectors and more take long */
    for (int x = 0; x < q->points; x++)
        for (int i = 0; i < N; i++)
            for (int j = i + 1; j < N; j++) {
                const Sections *at = &q->at[x];
                double product = at->moment[i] * at->moment[j], stiffness = 0, psi;
                if (product == 0 || q->place[x][i] < 0 || q->place[x][j] < 0) continue;
                for (int k = 0; k < N; k++) stiffness += at->stiffness[k];
                /* A tube curved backwards is one turned by half. */
                psi = state->theta[x][i] + at->phase[i] - state->theta[x][j] - at->phase[j] + (product < 0) * HALF_TURN;
                if (!add_coupling(c, x, i, j, psi, q->weight[x] * fabs(product) / stiffness)) return 0;
            }
    if (!factor_variation(q, state, 1, h)) return 0;
    memcpy(g, state->gradient, sizeof g);
    answer_all(c, g);
    return 1;
}

/* Least and largest cosine of the angles between two. */
static void range_of_cosine(double low, double high, double *least, double *most) {
    double a = cos(low), b = cos(high), turn = 2 * HALF_TURN;
    *least = floor((high - HALF_TURN) / turn) > floor((low - HALF_TURN) / turn) ? -1 : fmin(a, b);
    *most = floor(high / turn) > floor(low / turn) ? 1 : fmax(a, b);
}

/* What slides add to a box: to the range of w h the changed couplings, to its image the turned bases. */
static void add_slides(const Couplings *c, Box u, Box range, Box out) {
    double turned[2][N] = {{0}};
    for (int p = 0; p < c->count; p++) {
        double w = c->w[p], weak = c->weakest[p], strong = c->strongest[p], least, most;
        range_of_cosine(c->psi[p] - u[0][p] - HALF_TURN / 2, c->psi[p] + u[1][p] - HALF_TURN / 2, &least, &most);
        double down = -fmin(weak * least, strong * least), up = fmax(weak * most, strong * most);
        turned[0][c->tube[p][0]] += down, turned[1][c->tube[p][0]] += up;
        turned[0][c->tube[p][1]] += up, turned[1][c->tube[p][1]] += down;
        double a = (w - weak) * least, b = (w - strong) * least, d = (w - weak) * most, e = (w - strong) * most;
        range[0][p] += fmax(0, -fmin(fmin(a, b), fmin(d, e)));
        range[1][p] += fmax(0, fmax(fmax(a, b), fmax(d, e)));
    }
    for (int k = 0; k < N; k++) {
        double by = c->loosened[k], down = fmax(0, by < 0 ? -by * turned[1][k] : by * turned[0][k]);
        double up = fmax(0, by < 0 ? -by * turned[0][k] : by * turned[1][k]);
        for (int p = 0; p < c->count; p++) {
            double J = c->J[k][p];
            out[0][p] += J < 0 ? -J * up : J * down;
            out[1][p] += J < 0 ? -J * down : J * up;
        }
    }
}

/* The box to which a box u is mapped, with room for round-off, where y is that of J d; whether u holds it. */
static int map_box(const Couplings *c, Box y, Box u, Box out) {
    Box range; /* of w h, as boxes are */
    int holds = 1;
    for (int p = 0; p < c->count; p++) {
        double low = -u[0][p], high = u[1][p], first = h_at(c, p, low), last = h_at(c, p, high);
        double other = low <= c->extremum[p] && c->extremum[p] <= high ? c->at_extremum[p] : 0;
        range[0][p] = -c->w[p] * fmin(fmin(0, other), fmin(first, last));
        range[1][p] = c->w[p] * fmax(fmax(0, other), fmax(first, last));
        out[0][p] = y[0][p] + c->spare[p], out[1][p] = y[1][p] + c->spare[p];
    }
    if (c->slides) add_slides(c, u, range, out);
    for (int p = 0; p < c->count; p++) { /* G times the middle of the range, and |G| times its half width */
        double middle = 0, half = 0;
        const double *G = c->G[p];
        for (int r = 0; r < c->count; r++) {
            middle += G[r] * (range[1][r] - range[0][r]);
            half += fabs(G[r]) * (range[1][r] + range[0][r]);
        }
        out[0][p] += (half - middle) / 2, out[1][p] += (half + middle) / 2;
        holds &= out[0][p] <= u[0][p] && out[1][p] <= u[1][p];
    }
    return holds;
}

/* Whether H is positive at the smallest cosines of the angles in a box; at -1 where it is NULL: then nothing can snap. */
static int convex_in(const Couplings *c, Box u) {
    double factor[MOST_COUPLINGS], least = -1, most;
    for (int p = 0; p < c->count; p++) {
        if (u && (u[0][p] > MOST_CHANGE || u[1][p] > MOST_CHANGE)) return 0;
        if (u) range_of_cosine(c->psi[p] - u[0][p], c->psi[p] + u[1][p], &least, &most);
        factor[p] = (least < 0 ? c->strongest[p] : c->weakest[p]) * least;
    }
    return vary_couplings(c, c->softest, factor, 1 - LEAST_RISE);
}

/* Whether a box is found that is mapped into itself, and in which H is positive: by images from y on. Their steps come to
   shrink by a ratio; after some sweeps the box takes the rest of them (Aitken) and a little more, since images from above
   are mapped into themselves. Where that was too much, images go on from where they were, for longer. */
static int proves_sector(const Couplings *c, Box y) {
    Box u, image, below, step = {{0}};
    double size = 0;
    memcpy(u, y, sizeof u);
    for (int sweep = 1, since = 1, wait = 1, jumped = 0; sweep < SWEEPS; sweep++, since++) {
        double along = 0, before = size;
        int holds = map_box(c, y, u, image), settles = since >= wait * (3 + sweep / 12); /* longer where a second ratio is close */
        int wide = 0;
        if (holds && convex_in(c, u)) return 1;
        size = 0;
        for (int side = 0; side < 2; side++)
            for (int p = 0; p < c->count; p++) {
                double by = image[side][p] - u[side][p];
                along += by * step[side][p];
                size += by * by;
                step[side][p] = by;
                u[side][p] = image[side][p];
                wide |= u[side][p] > MOST_CHANGE && by > 0 && since > 1;
            }
        if (wide && !jumped) return 0;
        if (wide) {
            memcpy(u, below, sizeof u);
            since = jumped = 0, size = 0, wait *= 2;
            memset(step, 0, sizeof step);
            continue;
        }
        if (holds && size < SETTLED) return 0;
        if (!settles) continue;
        if (!jumped) memcpy(below, u, sizeof u);
        double left = along < before ? fmax(0, ROOM_LEFT * along / (before - along)) : 0;
        for (int side = 0; side < 2; side++)
            for (int p = 0; p < c->count; p++)
                u[side][p] = fmin(fmax(0, u[side][p] + left * step[side][p]) + SPARE, MOST_CHANGE);
        since = 0, jumped = 1;
    }
    return 0;
}

/* Whether turns of all tubes by at most r each are proved to cause no snap: sector by sector, conv(0, 2 r 1_T along a
   chain of sets T), numbered by orders of the tubes. */
static int proves_turn(const Couplings *c, double r) {
    for (int sector = 0; sector < SECTORS; sector++) {
        Box y = {{0}};
        double at[MOST_COUPLINGS] = {0};
        int left[N], order = sector;
        for (int k = 0; k < N; k++) left[k] = k;
        for (int k = N; k > 1; order /= k--) { /* the set of all tubes turns nothing */
            const double *J = c->J[left[order % k]];
            left[order % k] = left[k - 1];
            for (int p = 0; p < c->count; p++) {
                at[p] += 2 * r * J[p];
                y[0][p] = fmax(y[0][p], -at[p]), y[1][p] = fmax(y[1][p], at[p]);
            }
        }
        if (!proves_sector(c, y)) return 0;
        if (!r) break;
    }
    return 1;
}

/* The largest such r up to `most`, to a relative precision; INFINITY where nothing can snap at these translations. */
static double largest_turn(const Couplings *c, double most, double precision) {
    double proved = 0, refused = fmin(most, HALF_TURN), r = fmin(FIRST_TURN, refused / 2);
    if (!c->count || convex_in(c, NULL)) return INFINITY;
    if (most < HALF_TURN && proves_turn(c, most)) return most;
    while (refused - proved > precision * refused) {
        *(proves_turn(c, r) ? &proved : &refused) = r;
        r = refused < HALF_TURN ? (proved + refused) / 2 : fmin((proved + refused) / 2, 2 * proved);
    }
    return proved;
}

/* --- slides: of tubes of one arc each ---------------------------------------------------------------------------- */

typedef struct {
    Layout layout[2];  /* cut at the breakpoints before and after, with transmissions before, and with the longest ones */
    Unknowns fine[2];
    State state;
} Slides;

#define MOST_POLISH 8   /* Newton steps from an equilibrium on another mesh */
#define POLISHED 1e-11  /* rad, of the last of them */

/* The longest element, or piece where no tubes are coupled; infinite where there is no arm. */
static double longest_piece(const Layout *l) {
    double piece = 0, element = 0;
    for (int p = 0; p < l->pieces; p++) {
        piece = fmax(piece, l->length[p]);
        if (l->collocated[p]) element = fmax(element, l->length[p]);
    }
    return element > 0 ? element : piece > 0 ? piece : INFINITY;
}

/* The arm before and after slides to translations `after` as one mesh, on which a tube is curved where it ever is. */
static int lay_out_slides(const Tubes *t, const double *shift, const double *after, Slides *s, double change[N]) {
    double cuts[4 * N + 1] = {0}, bend[N][2], end[N][2], held[N][2], longest;
    Layout *near = s->layout, *far = s->layout + 1;
    Section curved[N];
    int count = 1, kept = 1;
    if (!lay_out(t, shift, NULL, near) || !lay_out(t, after, NULL, far)) return 0;
    longest = fmin(longest_piece(near), longest_piece(far));
    for (int i = 0; i < N; i++) {
        double middle = (t->straight[i] + t->whole[i]) / 2;
        if (!(t->kt[i] > 0)) return 0;
        curved[i] = section_of(t->pieces, i, panel_of(t->pieces, i, middle), middle, 1);
        for (int side = 0; side < 2; side++) {
            held[i][side] = s->layout[side].transmission[i];
            bend[i][side] = fmax(0, t->straight[i] - held[i][side]);
            end[i][side] = fmax(0, t->whole[i] - held[i][side]);
            cuts[count++] = bend[i][side], cuts[count++] = end[i][side];
        }
        change[i] = (held[i][0] - held[i][1]) / t->kt[i];
    }
    qsort(cuts, count, sizeof(double), compare);
    for (int k = 1; k < count; k++)
        if (cuts[k] - cuts[kept - 1] > ROUND_OFF_LENGTH) cuts[kept++] = cuts[k];
    near->pieces = far->pieces = 0;
    for (int i = 0; i < N; i++) {
        near->transmission[i] = held[i][0], far->transmission[i] = fmax(held[i][0], held[i][1]);
        for (int side = 0; side < 2; side++) {
            s->layout[side].held[i] = s->layout[side].transmission[i] / t->kt[i];
            s->layout[side].end[i] = fmax(end[i][0], end[i][1]);
        }
    }
    for (int k = 0; k + 1 < kept; k++) {
        double middle = (cuts[k] + cuts[k + 1]) / 2, length = cuts[k + 1] - cuts[k];
        Across here = {.bent = 0, .steady = 1};
        for (int i = 0; i < N; i++) {
            Section at = curved[i];
            here.even[i] = 1;
            here.present[i] = middle < near->end[i];
            here.curved[i] = here.present[i] && at.moment != 0 && fmin(bend[i][0], bend[i][1]) < middle;
            here.bent += here.curved[i];
            if (!here.present[i]) at.stiffness = 0;
            if (!here.curved[i]) at.moment = 0;
            put_section(&here.tubes, i, at);
        }
        for (int side = 0; side < 2; side++)
            if (!add_pieces(t, s->layout + side, k, cuts[k], length, here.bent < 2 ? 1 : fmax(1, ceil(length / longest - 1e-9)), &here, here.bent >= 2)) return 0;
    }
    return 1;
}

/* The couplings of an arm and of slides (n) of its tubes from there, each from 0 on, where `guess` is its equilibrium. 0 where that
   is not stable, -1 where there is no room for them, or a tube is made of pieces. */
static int find_slides(const Tubes *t, const double *alpha, const double *shift, const double *slide, const Guess *guess, Slides *s,
                       State *trial, Chain *h, Couplings *c) {
    double after[N], step = 0, stiffness[3], g[MOST_UNKNOWNS], factor[MOST_COUPLINGS];
    const Unknowns *q = s->fine;
    State *state = &s->state;
    c->q = q, c->softest = q + 1, c->trial = trial, c->h = h, c->count = 0, c->slides = 1;
    if (N > 4) return -1;
    for (int i = 0; i < N; i++) after[i] = fmin(shift[i] + slide[i], t->straight[i]);
    if (!lay_out_slides(t, shift, after, s, c->loosened)) return -1;
    for (int side = 0; side < 2; side++)
        if (!pose_unknowns(s->fine + side, s->layout + side, t, &FINE, 0)) return -1;
    for (int x = 0; x < q->points; x++)
        for (int i = 0; i < N; i++)
            for (int j = i + 1; j < N; j++) {
                const Sections *at = &q->at[x];
                double product = at->moment[i] * at->moment[j], w = q->weight[x] * fabs(product), place = q->s[x];
                int now = 1, always = 1;
                if (product == 0) continue;
                memset(stiffness, 0, sizeof stiffness); /* now, least, most */
                for (int k = 0; k < N; k++) {
                    double begins[2], ends[2], kb = at->stiffness[k];
                    int both = k == i || k == j;
                    for (int side = 0; side < 2; side++) {
                        double beta = fmin((side ? after[k] : shift[k]) - t->straight[k], 0);
                        begins[side] = fmax(0, beta + t->straight[k]), ends[side] = beta + t->whole[k];
                    }
                    stiffness[0] += (both || place < ends[0]) * kb;
                    stiffness[1] += (both || place < fmin(ends[0], ends[1])) * kb;
                    stiffness[2] += kb;
                    if (!both) continue;
                    now &= begins[0] < place && place < ends[0];
                    always &= fmax(begins[0], begins[1]) < place && place < fmin(ends[0], ends[1]);
                }
                if (!add_coupling(c, x, i, j, 0, now ? w / stiffness[0] : 0)) return -1;
                c->weakest[c->count - 1] = always ? w / stiffness[2] : 0;
                c->strongest[c->count - 1] = w / stiffness[1];
            }
    sample(q, guess, 0, state->theta);
    to_unknowns(q, alpha, state->theta, state->z);
    for (int iteration = 0;; iteration++) {
        turn_points(q, alpha, state);
        for (int p = 0; p < c->count; p++) {
            int x = c->point[p], i = c->tube[p][0], j = c->tube[p][1];
            const Sections *at = &q->at[x];
            c->psi[p] = state->theta[x][i] + at->phase[i] - state->theta[x][j] - at->phase[j] +
                        (at->moment[i] * at->moment[j] < 0) * HALF_TURN;
            factor[p] = c->w[p] * sin(c->psi[p]);
        }
        memset(g, 0, sizeof g);
        memcpy(g, state->z, q->size * sizeof *g);
        add_pulls(c, factor, g);
        for (int p = 0; p < c->count; p++) factor[p] = c->w[p] * cos(c->psi[p]);
        if (!vary_couplings(c, q, factor, 1)) return 0;
        if (iteration && step < POLISHED) break;
        if (iteration == MOST_POLISH) return 0;
        solve_variation(q, h, g);
        for (int r = 0; r < q->size; r++) state->z[r] -= g[r];
        step = turn_of(q, g);
    }
    answer_all(c, g);
    return 1;
}

/* Whether turns of all tubes by up to r and slides by up to `slide` (m), all to both sides, are proved to cause no snap: 1 or
   0, -1 where there is no room to tell. `first`: bits of the directions of the slides that are tried first, then those that failed. */
static int proves_joints(const Tubes *t, const double *alpha, const double *shift, double r, double slide, const Guess *guess, Slides *s,
                         State *trial, Chain *h, Couplings *c, int *first) {
    for (int k = 0; k < 1 << N; k++) {
        double by[N];
        int signs = k ^ *first;
        for (int i = 0; i < N; i++) by[i] = signs >> i & 1 ? slide : -slide;
        int found = find_slides(t, alpha, shift, by, guess, s, trial, h, c);
        if (found > 0 && proves_turn(c, r)) continue;
        *first = signs;
        return found < 0 ? -1 : 0;
    }
    return 1;
}

/* The largest factor up to `most` at which turns by `turn` and slides by `slide` of all tubes are proved to cause no snap, to a
   relative precision; `lacked` where a larger one might be with more room. */
static double largest_motion(const Tubes *t, const double *alpha, const double *shift, double turn, double slide, double most,
                             double precision, const Guess *guess, Slides *s, State *trial, Chain *h, Couplings *c, int *lacked) {
    double proved = 0, refused = most, factor = most;
    int first = 0;
    do {
        int found = proves_joints(t, alpha, shift, turn * factor, slide * factor, guess, s, trial, h, c, &first);
        if (found > 0 && factor == most) return most;
        *(found > 0 ? &proved : &refused) = factor;
        if (found <= 0) *lacked = found < 0;
        factor = proved > 0 ? fmin((proved + refused) / 2, 2 * proved) : refused / (refused < most ? 2 : 16);
    } while (refused - proved > precision * refused && refused > SMALLEST * most);
    return proved;
}
