/* What joint values, and a small wrench at the tip, change at a solved equilibrium of concentric tubes. */

#define MODE_ERROR 1e-26 /* square of how far off its direction may be */
#define ONE_VALUE 1e-9   /* between eigenvalues that are one */

typedef struct {
    double position[3][2 * N], turn[3][2 * N]; /* of the tip by rotations, then translations: per rad and per m */
    double tip_rotations[N][2 * N], margin[2 * N];
    double compliance[6][6]; /* force and moment -> translation and turn of the tip, world axes, at no load */
    double energy[2 * N];
} Slopes;

/* What is asked of them. Tubes of one carriage move together, and share its slope; where breakpoints coincide, it is that
   towards the carriage's side, 1 or -1. The compliance, half of the work, where it is not 0; of a margin that two modes
   share, no slope (NAN) where `either` is 0, else that of one of them. */
typedef struct {
    long long carriage[N], side[N], compliance, either;
} Asked;

/* (m, 3, 2 N) of the shape points by joints, as the tip's. */
typedef double Along[3][2 * N];

/* A share of a column as column c of all slopes. */
static void put_column(const Column *column, const Around *a, int last, int c, double share, Slopes *slopes, Along *along) {
    for (int at = 0; at <= last && along; at++)
        for (int r = 0; r < 3; r++) along[at][r][c] = share * (at < last ? a->shift[at][r] : column->position[r]);
    for (int r = 0; r < 3; r++) {
        slopes->position[r][c] = share * column->position[r];
        slopes->turn[r][c] = share * column->turn[r];
    }
    for (int i = 0; i < N; i++) slopes->tip_rotations[i][c] = share * column->tip_rotations[i];
    slopes->margin[c] = share * column->margin;
    slopes->energy[c] = share * column->energy;
}

static void by_carriage(const Unknowns *q, const State *state, const Answer *out, const Chain *h, const long long *carriage,
                        long long own, int side, Around *a, Slopes *slopes, Along *along) {
    Change change = {.side = side};
    Column column;
    int mine[N], size = 0;
    for (int i = 0; i < N; i++) {
        size += mine[i] = carriage[i] == own;
        if (mine[i]) lengthen(q, a, i, -1, &change);
    }
    clear_gains(q, a);
    carry_along(q, mine, a, &change);
    add_jumps(q, mine, 0, a, &change);
    change.pushed = pushes(q, out, mine, side);
    change_by(q, state, out, h, &change, along != NULL, a, &column);
    for (int i = 0; i < N; i++)
        if (mine[i]) put_column(&column, a, q->layout->pieces * STEPS, N + i, 1.0 / size, slopes, along);
}

/* Column v of the compliance: a unit force (v < 3) or moment at the tip. */
static void by_wrench(const Unknowns *q, const State *state, const Answer *out, const Chain *h, int v, Around *a,
                      Slopes *slopes) {
    static const double none[N];
    const Layout *l = q->layout;
    int k = q->tableau->degree, last = l->pieces * STEPS, held = 0;
    double unit[3] = {v % 3 == 0, v % 3 == 1, v % 3 == 2}, turn[3];
    while (held + 1 < N && l->end[held] < out->arc_length[last] - SAME_END) held++; /* as robots/order.py */
    clear_gains(q, a);
    for (int x = 0; x < l->pieces * k; x++) {
        double moment[3] = {0}, lever[3], stiffness = 0;
        for (int r = 0; r < 3; r++) lever[r] = out->position[last][r] - a->position[x][r];
        if (v < 3)
            add_cross(lever, unit, moment);
        else
            memcpy(moment, unit, sizeof moment);
        for (int i = 0; i < N; i++) stiffness += a->at[x].stiffness[i];
        for (int j = 0; j < 2; j++) {
            double pull = 0;
            for (int r = 0; r < 3; r++) pull += a->frame[x][3 * r + j] * moment[r];
            for (int i = 0; i < N; i++)
                a->change.moment[x / k][x % k * N + i] -= pull * a->bend_slope[x][2 * i + j];
            a->sway[x][j] = pull / stiffness;
        }
    }
    if (v >= 3) a->gains.kicks[l->pieces][held] = -out->frame[last][3 * (v - 3) + 2];
    respond(q, state, h, none, a);
    move_arm(q, out, 1, 0, a, turn);
    for (int r = 0; r < 3; r++) {
        slopes->compliance[r][v] = a->shift[last][r];
        slopes->compliance[3 + r][v] = turn[r] + out->frame[last][3 * r + 2] * a->change.rotation[l->pieces][held];
    }
}

/* Whether two modes share the least eigenvalue of the second variation, one of which is `mode`, of unit length: with that
   one raised by 1, the least is that of another. */
static int shared(const Unknowns *q, const double *mode, double least, const Chain *h) {
    double other[MOST_UNKNOWNS], solved[MOST_UNKNOWNS];
    memcpy(solved, mode, q->size * sizeof(double));
    solve_variation(q, h, solved);
    anywhere(other, q->size);
    return least_eigenvalue((Factored){q, h, mode, solved}, MODE_ERROR, 0, 0, other) - least < ONE_VALUE;
}

/* All slopes at what `solve` has just left. 0 where the second variation is singular. Into `along`, where not NULL, those of
   the shape points. */
CASADI_SYMBOL_EXPORT int differentiate(const Asked *asked, Workspace *w, const Answer *out, Slopes *slopes,
                                       Along *along) {
    const Unknowns *q = &w->fine;
    const State *state = &w->state;
    const long long *carriage = asked->carriage;
    Chain *h = &w->chain;
    Around *a = &w->around;
    if (!factor_variation(q, state, 1, h)) return 0;
    memset(&a->mode, 0, sizeof a->mode);
    memset(&a->change, 0, sizeof a->change);
    a->released = 0;
    look_around(q, &w->arm, out, a);
    if (out->margin < FLAT) {
        double mode[MOST_UNKNOWNS];
        anywhere(mode, q->size);
        double least = least_eigenvalue((Factored){q, h, NULL, NULL}, MODE_ERROR, 0, 0, mode);
        a->released = 1 - least;
        lean_of_margin(q, state, mode, a);
        if (!asked->either && shared(q, mode, least, h)) a->form = NAN;
    }
    for (int i = 0; i < N; i++) {
        /* The equilibrium is a minimum of the energy: only what a joint does at a fixed shape counts. */
        Change change = {.energy = -w->arm.torque[0][i]};
        Column column;
        int first = 1;
        change.base[i] = 1;
        clear_gains(q, a);
        change_by(q, state, out, h, &change, along != NULL, a, &column);
        put_column(&column, a, q->layout->pieces * STEPS, i, 1, slopes, along);
        for (int j = 0; j < i; j++) first &= carriage[j] != carriage[i];
        if (first) by_carriage(q, state, out, h, carriage, carriage[i], asked->side[i], a, slopes, along);
    }
    for (int v = 0; v < 6 && asked->compliance; v++) by_wrench(q, state, out, h, v, a, slopes);
    return 1;
}
