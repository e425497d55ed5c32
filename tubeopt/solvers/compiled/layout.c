/* Joint values -> sections -> pieces of the mesh: what robots/assembly.py and block/transcription/mesh.py do. */

/* The tubes on a section, of which `bent` are curved; those that are the same all along it are even, and known. */
typedef struct {
    int present[N], curved[N], bent, even[N], steady; /* steady: all are even */
    Sections tubes;
} Across;

typedef struct {
    int pieces, sections;
    double start[MOST_PIECES], length[MOST_PIECES];
    int section[MOST_PIECES], collocated[MOST_PIECES];
    Across across[MOST_PIECES];
    /* Of tubes that are not even, the panel along the piece, -1 where it changes; where the piece begins on it, from -1 to 1, and how far
       it goes. */
    int panel[MOST_PIECES][N];
    double at[MOST_PIECES][N], span[MOST_PIECES][N];
    double transmission[N], end[N], section_start[MOST_SECTIONS + 1];
    double held[N]; /* int ds / kt of the transmissions */
} Layout;

typedef struct {
    double kt[N]; /* of tubes of one arc each; 0 of others */
    double straight[N], whole[N], offset[N], angle[N];
    long long eccentric;
    const Pieces *pieces;
} Tubes;

static int compare(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Cut the arm at every transition and end in front of the plate; 0 where that cannot be. */
static int cuts_of(const Tubes *t, const double *shift, Layout *l, double *cuts) {
    int count = 0, kept = 1;
    cuts[count++] = 0;
    for (int i = 0; i < N; i++) {
        if (!(shift[i] - t->straight[i] <= ROUND_OFF_LENGTH)) return 0; /* out of its actuator */
        double beta = fmin(shift[i] - t->straight[i], 0.0);
        l->transmission[i] = -beta;
        l->end[i] = beta + t->whole[i];
        cuts[count++] = fmax(l->end[i], 0.0);
        l->held[i] = compliant(t->pieces, i, -beta);
        for (int k = 0; k < t->pieces->most_cuts; k++) {
            double cut = beta + t->pieces->cuts[i * t->pieces->most_cuts + k];
            if (!isfinite(cut) || count == MOST_CUTS) break;
            if (cut > 0) cuts[count++] = cut;
        }
        if (count == MOST_CUTS) return 0;
    }
    qsort(cuts, count, sizeof(double), compare);
    for (int k = 1; k < count; k++)
        if (cuts[k] - cuts[kept - 1] > ROUND_OFF_LENGTH) cuts[kept++] = cuts[k];
    return kept;
}

static Across across(const Tubes *t, const Layout *l, double low, double high) {
    Across a = {.bent = 0, .steady = 1};
    for (int i = 0; i < N; i++) {
        double held = l->transmission[i], place = (low + high) / 2 + held;
        int panel = panel_of(t->pieces, i, place);
        a.present[i] = (low + high) / 2 < l->end[i];
        a.curved[i] = a.present[i] && t->pieces->bent[i * t->pieces->most + panel];
        a.bent += a.curved[i];
        a.even[i] = count_of(t->pieces, i, panel, CHANNELS) == 1 && count_of(t->pieces, i, panel, 4) == 1 &&
                    panel_between(t->pieces, i, low + held, high + held) == panel;
        a.steady &= a.even[i];
        if (a.even[i]) put_section(&a.tubes, i, section_of(t->pieces, i, panel, place, a.present[i]));
    }
    return a;
}

/* What a section asks of its pieces, per length: for coupling, bend, detail and natural twist; and its least sum of kb and
   largest m / kt. */
typedef struct {
    double fastest, steepest, finest, softest, pull;
} Needs;

static Needs needs_of(const Tubes *t, const Layout *l, double start, double length, const Across *a) {
    Needs needs = {0, 0, 0, INFINITY, 0};
    for (int g = 0; g < (a->steady ? 1 : 8); g++) {
        double s = start + length * SAMPLES[g], kb[N], m[N], kt[N], most = -INFINITY, least = INFINITY, sum = 0;
        for (int i = 0; i < N; i++) {
            double place = s + l->transmission[i];
            int own = panel_of(t->pieces, i, place);
            size_t panel = i * t->pieces->most + own;
            Section here = a->even[i] ? section_in(&a->tubes, i) : section_of(t->pieces, i, own, place, a->present[i]);
            kb[i] = here.stiffness;
            m[i] = fabs(here.moment);
            kt[i] = 1 / here.rate;
            sum += kb[i];
            if (!a->present[i]) continue;
            needs.finest = fmax(needs.finest, t->pieces->detail[panel] / DETAIL_PER_ELEMENT);
            if (!(m[i] > 0)) continue;
            needs.steepest = fmax(needs.steepest, m[i] / kb[i]);
            needs.pull = fmax(needs.pull, m[i] / kt[i]);
            needs.finest = fmax(needs.finest, t->pieces->twist[panel] / TWIST_PER_ELEMENT);
            double turning = t->pieces->twist[panel] > 0 ? twist_of(t->pieces, i, own, place) : 0;
            most = fmax(most, turning);
            least = fmin(least, turning);
        }
        if (most > least) needs.finest = fmax(needs.finest, (most - least) / TWIST_PER_ELEMENT);
        const double *in[] = {kb, m, kt};
        double rate, *out[] = {&rate};
        coupling_rate(in, out, 0, 0, 0);
        needs.fastest = fmax(needs.fastest, rate);
        needs.softest = fmin(needs.softest, sum);
    }
    return needs;
}

/* Where the tubes that vary are along a piece. */
static void place_tubes(const Tubes *t, Layout *l, int p) {
    for (int i = 0; i < N; i++) {
        if (l->across[p].even[i]) continue;
        double held = l->start[p] + l->transmission[i];
        int own = l->panel[p][i] = panel_between(t->pieces, i, held, held + l->length[p]);
        if (own < 0) continue;
        const double *breaks = t->pieces->breaks + i * (t->pieces->most + 1) + own;
        l->span[p][i] = 2 * l->length[p] / (breaks[1] - breaks[0]);
        l->at[p][i] = (2 * held - breaks[0] - breaks[1]) / (breaks[1] - breaks[0]);
    }
}

/* A section as `count` pieces of one length; 0 where there is no room for them. */
static int add_pieces(const Tubes *t, Layout *l, int section, double from, double length, double count, const Across *a,
                      int collocated) {
    if (l->pieces + count > MOST_PIECES) return 0;
    for (int j = 0; j < (int)count; j++) {
        int p = l->pieces++;
        l->length[p] = length / count;
        l->start[p] = from + j * l->length[p];
        l->section[p] = section;
        l->collocated[p] = collocated;
        l->across[p] = *a;
        place_tubes(t, l, p);
    }
    return 1;
}

/* Friction between neighbours: torque per length (N - 1), N, more of it per bending moment (N - 1), 1/m, and along how
   many pieces two tubes rub at least. */
typedef struct {
    const double *torque, *by_moment;
    double pieces;
} Friction;

/* The mesh at translations; where tubes rub, if there is friction, their rotations are unknown, too. 0 where there is no
   room for it. */
static int lay_out(const Tubes *t, const double *shift, const Friction *friction, Layout *l) {
    double cuts[MOST_CUTS];
    int count = cuts_of(t, shift, l, cuts);
    if (!count || count - 1 > MOST_SECTIONS) return 0;
    l->pieces = 0;
    l->sections = count - 1;
    for (int k = 0; k + 1 < count; k++) {
        double length = cuts[k + 1] - cuts[k];
        Across here = across(t, l, cuts[k], cuts[k + 1]);
        Needs needs = needs_of(t, l, cuts[k], length, &here);
        double shape = fmax(needs.steepest / BEND_PER_ELEMENT, needs.finest);
        if (here.bent < 2 && needs.finest > 0) shape *= KNOWN;
        double need = length * fmax(needs.fastest / WAVES_PER_ELEMENT, shape);
        double wanted = need > 0 ? fmax(1.0, ceil(need - 1e-9)) * (1 << t->pieces->refinement) : 1;
        int collocated = here.bent >= (t->eccentric ? 1 : 2);
        for (int i = 0; i < N && friction; i++) here.curved[i] &= collocated; /* `curved` marks the unknowns */
        for (int i = 0; i + 1 < N && friction; i++) {
            if (!(here.present[i + 1] && friction->torque[i] + friction->by_moment[i] > 0)) continue;
            here.curved[i] = here.curved[i + 1] = collocated = 1;
            wanted = fmax(wanted, ceil(length * friction->pieces / l->end[i + 1] - 1e-9));
        }
        l->section_start[k] = cuts[k];
        if (!add_pieces(t, l, k, cuts[k], length, wanted, &here, collocated)) return 0;
    }
    return 1; /* no piece: an arm of length zero */
}

/* Where a tube ends: the piece that begins there. */
static int ending(const Layout *l, int tube) {
    int p = 0;
    while (p < l->pieces && l->start[p] < fmax(l->end[tube], 0) - ROUND_OFF_LENGTH) p++;
    return p;
}

/* Panel of a tube at fraction x of a piece; at the ends, where it may jump, that of a point slightly inside. */
static inline int panel_on(const Tubes *t, const Layout *l, int p, int tube, double x) {
    if (l->panel[p][tube] >= 0) return l->panel[p][tube];
    return panel_of(t->pieces, tube, l->start[p] + l->transmission[tube] + (x + INWARDS * (0.5 - x)) * l->length[p]);
}

/* A tube at fraction x of a piece. */
static inline Section section_on(const Tubes *t, const Layout *l, int p, int tube, double x) {
    if (l->across[p].even[tube]) return section_in(&l->across[p].tubes, tube);
    int panel = l->panel[p][tube], present = l->across[p].present[tube];
    if (panel >= 0) {
        double at = l->at[p][tube] + x * l->span[p][tube];
        return section_at(t->pieces, tube, panel, at < -1 ? -1 : at > 1 ? 1 : at, present);
    }
    double place = l->start[p] + l->transmission[tube] + x * l->length[p];
    return section_of(t->pieces, tube, panel_on(t, l, p, tube, x), place, present);
}

/* All tubes there. */
static void sections_on(const Tubes *t, const Layout *l, int p, double x, Sections *out) {
    for (int i = 0; i < N; i++) put_section(out, i, section_on(t, l, p, i, x));
}

/* u*_z of a tube at fraction x of a piece, the same. */
static double twist_on(const Tubes *t, const Layout *l, int p, int tube, double x) {
    if (l->across[p].even[tube] || !l->across[p].present[tube]) return 0;
    double place = l->start[p] + l->transmission[tube] + x * l->length[p];
    return twist_of(t->pieces, tube, panel_on(t, l, p, tube, x), place);
}
