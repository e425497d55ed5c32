/* The numbers of a robot, which the page gives while it runs: a robot of fewer than N tubes has tubes of no length outside
   of its own. Each is straight, then curved with one radius. */
#define JOINTS (2 * N)
#define ORDERS (2 * (N - 1))
#define BREAKS (2 * N)
#define MOST_ROWS (2 * JOINTS + ORDERS + 1 + BREAKS + TUBEOPT_MOST_CONTACTS)
#define NOWHERE (-1e3) /* place (m) of a breakpoint that a tube does not have: always behind the plate */
#define LONGEST_TUBE longest
#define PANELS 2
#define TRIALS 0 /* the page searches no closest pose */

static double longest, SPREAD[2 * N * JOINTS], OFFSET[2 * N], LOWER[JOINTS], UPPER[JOINTS], SCALE[JOINTS];
static double ORDER[ORDERS * JOINTS], LEAST[ORDERS];
static const double STARTS[1];
static long long CARRIAGES[N];
static int FIRST[2 * N], BREAK_CARRIAGE[BREAKS];
static double BREAK_AT[BREAKS]; /* transition and end of each tube at its translation 0 */

static double breaks[N][PANELS + 1], coefficients[N][PANELS][2][LANES], counts[N][PANELS][CHANNELS + 1];
static double direction[N][PANELS], bent[N][PANELS], detail[N][PANELS], twist[N][PANELS], compliance[N][PANELS];
static double cuts[N][PANELS + 1];

Pieces PIECES = {PANELS, 2, PANELS + 1, breaks[0], coefficients[0][0][0], counts[0][0], direction[0], bent[0], detail[0],
                 twist[0], compliance[0], cuts[0], 0};
Tubes ROBOT = {.eccentric = 0, .pieces = &PIECES};
double MASS[N];

/* What the page gives of a tube: EI, GJ, curvature, lengths, mass per length, and ranges of its joints; SI. */
typedef struct {
    double kb, kt, curvature, straight, curved, mass, turn[2], shift[2];
} Given;

/* A tube as robots/lengthwise.py has it: one panel for each of its parts that has a length. */
static void use_panels(int i, const Given *g) {
    double lengths[PANELS] = {g->straight, g->curved}, bends[PANELS] = {0, g->curvature}, along = 0;
    int panels = 0;
    breaks[i][0] = cuts[i][0] = 0;
    for (int k = 0; k < PANELS; k++) {
        if (!(lengths[k] > 0)) continue;
        double *c = coefficients[i][panels][0];
        compliance[i][panels] = along / g->kt;
        c[0] = g->kb;
        c[1] = g->kt;
        c[2] = bends[k];
        bent[i][panels] = bends[k] != 0;
        along += lengths[k];
        panels++;
        breaks[i][panels] = cuts[i][panels] = along;
    }
    if (!panels) breaks[i][++panels] = 1; /* a tube of no length is nowhere */
    coefficients[i][0][0][0] = g->kb;
    coefficients[i][0][0][1] = g->kt;
    for (int k = panels; k < PANELS; k++) breaks[i][k + 1] = cuts[i][k + 1] = INFINITY;
    if (!(along > 0)) cuts[i][1] = INFINITY;
    for (int k = 0; k < PANELS; k++)
        for (int j = 0; j <= CHANNELS; j++) counts[i][k][j] = 1;
}

/* The order of tubes as robots/order.py has it: each is held behind the next outer one, and ends beyond it. */
static void use_order(int tubes) {
    memset(ORDER, 0, sizeof ORDER);
    memset(LEAST, 0, sizeof LEAST);
    for (int i = 0; i + 1 < tubes; i++) {
        double *behind = ORDER + 2 * i * JOINTS, *beyond = behind + JOINTS;
        behind[N + i + 1] = beyond[N + i] = 1;
        behind[N + i] = beyond[N + i + 1] = -1;
        LEAST[2 * i] = ROBOT.straight[i + 1] - ROBOT.straight[i];
        LEAST[2 * i + 1] = (ROBOT.whole[i + 1] - ROBOT.straight[i + 1]) - (ROBOT.whole[i] - ROBOT.straight[i]);
        double play = -LEAST[2 * i] - LEAST[2 * i + 1];
        if (play < ROUND_OFF_LENGTH) { /* they end together: what is left to them is round-off */
            LEAST[2 * i] -= ROUND_OFF_LENGTH;
            LEAST[2 * i + 1] -= ROUND_OFF_LENGTH;
        }
    }
}

static void use_tubes(int tubes, const Given *given) {
    const Given none = {0, 1, 0, 0, 0, 0, {0, 0}, {0, 0}};
    longest = 0;
    memset(coefficients, 0, sizeof coefficients);
    memset(compliance, 0, sizeof compliance);
    memset(bent, 0, sizeof bent);
    for (int i = 0; i < N; i++) {
        const Given *g = i < tubes ? given + i : &none;
        ROBOT.straight[i] = g->straight;
        ROBOT.whole[i] = g->straight + g->curved;
        MASS[i] = g->mass;
        longest = fmax(longest, ROBOT.whole[i]);
        use_panels(i, g);
        CARRIAGES[i] = FIRST[N + i] = BREAK_CARRIAGE[2 * i] = BREAK_CARRIAGE[2 * i + 1] = i;
        BREAK_AT[2 * i] = g->curvature ? 0 : NOWHERE;
        BREAK_AT[2 * i + 1] = i < tubes ? g->curved : NOWHERE;
        LOWER[i] = g->turn[0];
        UPPER[i] = g->turn[1];
        LOWER[N + i] = g->shift[0];
        UPPER[N + i] = g->shift[1];
    }
    for (int k = 0; k < JOINTS; k++) {
        SPREAD[k * JOINTS + k] = 1;
        SCALE[k] = k < N ? 1 : longest / 2;
    }
    use_order(tubes);
}
