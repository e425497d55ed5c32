/* Newton's equations of a loaded arm, eliminated piece by piece from the tip to the plate: the cost grows with the pieces,
   where a dense matrix of all unknowns would cost their cube.

   On a piece the twists v and the bending p = du / softness of its points are unknown, whitened so that the elastic energy
   is (|v|^2 + |p - g|^2) / 2, g = u0' dtheta / softness: they and the state where it begins (theta, dQ) make the state
   where it ends. What lies ahead costs a quadratic form of that state; eliminated, the piece leaves such a form of the
   state where it begins. All pivots are positive if and only if the second variation is. */

/* A linear functional of a small change, or the gradient of the energy: by theta and p at the points, by the twists, by
   Q at the points, and by the state at the tip. */
typedef struct {
    double theta[MOST_POINTS][N], bend[MOST_POINTS][2], orientation[MOST_POINTS][4], end[STATE];
    double twist[MOST_PIECES][N * MOST_DEGREE], held[N];
    int has_orientation, has_twist;
} Functional;

/* A change: of theta and p at the points, the twists, dQ at the points, and what was put in. */
typedef struct {
    double theta[MOST_POINTS][N], bend[MOST_POINTS][2], orientation[MOST_POINTS][4];
    double twist[MOST_PIECES][N * MOST_DEGREE], held[N];
    double local[MOST_PIECES][WIDTH], root[N]; /* on the way to it */
    Functional by;
} Step;

/* What a form in theta and in q at the points adds to the second variation. */
typedef struct {
    double theta[MOST_POINTS][N][N], bend[MOST_POINTS];
} Softening;

/* dQ_c / du_b and the same of Q at the end. */
OF_DEGREE void spread_bending(const Stage *s, const State *state, int e, Piece *piece, int k) {
    double half = s->problem->length[e] / 2;
    const double *matrix = s->rule->matrix, *weights = s->rule->weights;
    for (int b = 0; b < k; b++) {
        double through[MOST_DEGREE][4] = {{0}};
        for (int a = 0; a < k; a++)
            for (int c = 0; c < k; c++) EACH(FOUR(through[c]) += half * matrix[a * k + b] * FOUR(piece->inverse[a][c]));
        double onwards[4] = {half * weights[b]};
        for (int c = 0; c < k; c++) {
            const double *u = state->curvature[e * k + c];
            double rate[4] = {0, u[0], u[1], 0};
            add_product(half * weights[c], through[c], rate, onwards);
        }
        for (int j = 0; j < 2; j++) {
            double axis[4] = {0, j == 0, j == 1, 0}, moved[4];
            product(state->stage[e * k + b], axis, moved);
            product(moved, onwards, piece->leaving[b][j]);
            for (int c = 0; c < k; c++) product(moved, through[c], piece->own[c][b][j]);
        }
    }
}

/* The part of the matrix in twists and rotations, and how bending leans on them. */
OF_DEGREE void put_torsion(Stage *s, const State *state, double factor, double elastic, const Softening *by, int e, Piece *piece, int k) {
    int states = piece->rows;
    double *h = piece->matrix, (*stiff)[N][N] = s->stiff + e * k, (*gain)[N][2] = s->gain + e * k;
    for (int a = 0; a < k; a++) {
        int x = e * k + a;
        double bending = elastic + (by ? by->bend[x] : 0);
        for (int i = 0; i < N; i++)
            for (int j = 0; j < 2; j++) gain[a][i][j] = state->turned[x][i][j] / s->soft[x];
        for (int i = 0; i < N; i++)
            for (int j = 0; j < N; j++)
                stiff[a][i][j] = s->weight[x] * state->slope[x][j * N + i] + bending * dot(gain[a][i], gain[a][j], 2) -
                                 (i == j) * factor * dot(state->felt[x], state->second[x][i], 2) + (by ? by->theta[x][i][j] : 0);
    }
    for (int i = 0; i < N; i++) {
        if (piece->count[i] < k) continue;
        int row = piece->first[i];
        for (int j = 0; j < N; j++) {
            if (piece->count[j] < k) continue;
            double through[MOST_DEGREE][MOST_DEGREE];
            for (int a = 0; a < k; a++)
                for (int b = 0; b < k; b++) through[b][a] = piece->turn[i][a][b] * stiff[a][i][j];
            for (int b = 0; b < k; b++) {
                double sum = 0, pair[MOST_DEGREE] = {0};
                for (int a = 0; a < k; a++) sum += through[b][a];
                h[(row + b) * WIDTH + states + j] += sum;
                for (int a = 0; a < k && j >= i; a++)
                    for (int c = 0; c < k; c++) pair[c] += through[b][a] * piece->turn[j][a][c];
                for (int c = 0; c < k && j >= i; c++) h[(row + b) * WIDTH + piece->first[j] + c] += pair[c];
            }
            for (int a = 0; a < k && j >= i; a++) h[(states + i) * WIDTH + states + j] += stiff[a][i][j];
        }
        for (int a = 0; a < k; a++)
            for (int v = 0; v < 2; v++) {
                int column = piece->bend + 2 * a + v;
                double pull = (elastic + (by ? by->bend[e * k + a] : 0)) * gain[a][i][v];
                for (int b = 0; b < k; b++) h[(row + b) * WIDTH + column] -= piece->turn[i][a][b] * pull;
                h[column * WIDTH + states + i] -= pull;
            }
    }
}

/* The second derivative of the work by bending and by Q where the piece begins, upper triangle. */
OF_DEGREE void find_work(const Stage *s, const State *state, double factor, int e, Piece *piece, int k) {
    int size = 2 * k + 4;
    double (*sum)[WORK] = piece->work;
    memset(sum, 0, sizeof piece->work);
    for (int c = 0; c < k; c++) {
        int x = e * k + c;
        double moved[4][WORK], pulled[4][WORK];
        for (int b = 0; b < k; b++)
            for (int j = 0; j < 2; j++)
                for (int r = 0; r < 4; r++) moved[r][2 * b + j] = piece->own[c][b][j][r] * s->soft[e * k + b];
        for (int d = 0; d < 4; d++) {
            double unit[4] = {d == 0, d == 1, d == 2, d == 3}, there[4];
            product(unit, piece->spread[c], there);
            for (int r = 0; r < 4; r++) moved[r][2 * k + d] = there[r];
        }
        for (int r = 0; r < 4; r++)
            for (int v = 0; v < size; v++) {
                pulled[r][v] = 0;
                for (int d = 0; d < 4; d++) pulled[r][v] += factor * state->form[x][r][d] * moved[d][v];
            }
        for (int j = 0; j < 2; j++) {
            double axis[4] = {0, j == 0, j == 1, 0}, mixed[4] = {0};
            add_transposed(factor * s->soft[x], state->multiplier[x], axis, mixed);
            double across[WORK] = {0};
            for (int r = 0; r < 4; r++)
                for (int v = 0; v < size; v++) across[v] += mixed[r] * moved[r][v];
            int row = 2 * c + j;
            for (int v = row; v < size; v++) sum[row][v] += across[v];
            for (int v = 0; v <= row; v++) sum[v][row] += across[v];
        }
        for (int u = 0; u < size; u++)
            for (int v = u / 4 * 4; v < size; v++) {
                double both = 0;
                for (int r = 0; r < 4; r++) both += moved[r][u] * pulled[r][v];
                sum[u][v] += both;
            }
    }
}

/* The state at the end by twists, bending and the state at the beginning. */
static void put_map(const Stage *s, int e, Piece *piece) {
    int k = s->degree;
    memset(piece->map, 0, sizeof piece->map);
    for (int i = 0; i < N; i++) {
        for (int b = 0; b < piece->count[i]; b++) piece->map[i][piece->first[i] + b] = piece->passed[i][b];
        piece->map[i][piece->rows + i] = 1;
    }
    for (int b = 0; b < k; b++)
        for (int j = 0; j < 2; j++)
            for (int r = 0; r < 4; r++)
                piece->map[N + r][piece->bend + 2 * b + j] = piece->leaving[b][j][r] * s->soft[e * k + b];
    for (int d = 0; d < 4; d++) {
        double unit[4] = {d == 0, d == 1, d == 2, d == 3}, there[4];
        product(unit, piece->carried, there);
        for (int r = 0; r < 4; r++) piece->map[N + r][piece->rows + N + d] = there[r];
    }
}

/* What of a state does not depend on how stiff the arm is. */
static void assemble(Stage *s, const State *state, double factor) {
    for (int e = 0; e < s->pieces; e++) {
        Piece *piece = &s->piece[e];
        BY_DEGREE(spread_bending, s, state, e, piece);
        BY_DEGREE(find_work, s, state, factor, e, piece);
        put_map(s, e, piece);
    }
    s->assembled = 1;
}

/* The part of the matrix in bending and in Q where the piece begins: minus the second derivative of the work. */
OF_DEGREE void put_work(Piece *piece, int k) {
    int size = 2 * k + 4, where[WORK];
    for (int v = 0; v < size; v++) where[v] = v < 2 * k ? piece->bend + v : piece->rows + N + v - 2 * k;
    for (int u = 0; u < size; u++)
        for (int v = u; v < size; v++) piece->matrix[where[u] * WIDTH + where[v]] -= piece->work[u][v];
}

/* What lies ahead of a piece, a quadratic form of the state where it ends, by all that makes this state, upper triangle. A
   twist makes the rotation of its tube alone, bending makes Q. */
static void add_ahead(Piece *piece, double (*ahead)[STATE]) {
    double pulled[STATE][WIDTH];
    int whole = piece->whole;
    for (int c = 0; c < whole; c += 4)
        for (int m = 0; m < STATE; m++) {
            Four sum = {0};
            for (int d = 0; d < STATE; d++) EACH(OF(sum) += ahead[m][d] * FOUR(piece->map[d] + c));
            EACH(FOUR(pulled[m] + c) = OF(sum));
        }
    for (int r = 0; r < whole; r++) {
        double *row = piece->matrix + r * WIDTH;
        for (int i = 0; i < N; i++) {
            double scale = piece->map[i][r];
            if (scale == 0) continue;
            for (int c = r / 4 * 4; c < whole; c += 4) EACH(FOUR(row + c) += scale * FOUR(pulled[i] + c));
        }
        if (r < piece->bend || (r >= piece->rows && r < piece->rows + N)) continue;
        double scale[4];
        for (int d = 0; d < 4; d++) scale[d] = piece->map[N + d][r];
        for (int c = r / 4 * 4; c < whole; c += 4) {
            Four sum;
            EACH(OF(sum) = FOUR(row + c));
            for (int d = 0; d < 4; d++) EACH(OF(sum) += scale[d] * FOUR(pulled[N + d] + c));
            EACH(FOUR(row + c) = OF(sum));
        }
    }
}

/* Factors of the second variation at `state`, its torsional and bending part taken `elastic` times: 1, or 1 - mu to ask
   whether the margin is above mu; and what `by` adds, if not NULL. 0 where it is not positive definite. */
static int factorise_softened(Stage *s, const State *state, double factor, double elastic, const Softening *by) {
    double ahead[STATE][STATE] = {{0}};
    if (!s->assembled) assemble(s, state, factor);
    for (int e = s->pieces - 1; e >= 0; e--) {
        Piece *piece = &s->piece[e];
        double *h = piece->matrix;
        int whole = piece->whole;
        for (int r = 0; r < whole; r++) {
            for (int c = r / 4 * 4; c < whole; c++) h[r * WIDTH + c] = 0;
            h[r * WIDTH + r] = r < piece->rows ? elastic : 0;
        }
        for (int b = 0; b < 2 * s->degree && by; b++) h[(piece->bend + b) * (WIDTH + 1)] += by->bend[e * s->degree + b / 2];
        BY_DEGREE(put_torsion, s, state, factor, elastic, by, e, piece);
        BY_DEGREE(put_work, piece);
        if (e + 1 < s->pieces) add_ahead(piece, ahead);
        if (!eliminate(h, piece->rows, whole, WIDTH)) return 0;
        for (int m = 0; m < STATE; m++)
            for (int d = m; d < STATE; d++)
                ahead[m][d] = ahead[d][m] = h[(piece->rows + m) * WIDTH + piece->rows + d];
    }
    for (int i = 0; i < N; i++)
        for (int j = 0; j <= i; j++) {
            double sum = (i == j) * elastic + s->root_spring[i] * ahead[i][j] * s->root_spring[j] - dot(s->root[i], s->root[j], j);
            if (i == j && !(sum > 1e-13)) return 0;
            s->root[i][j] = i == j ? sqrt(sum) : sum / s->root[j][j];
        }
    return 1;
}

static int factorise(Stage *s, const State *state, double factor, double elastic) {
    return factorise_softened(s, state, factor, elastic, NULL);
}

OF_DEGREE void sweep_back_of(const Stage *s, const Functional *by, Step *step, int k) {
    double ahead[STATE];
    memcpy(ahead, by->end, sizeof ahead);
    for (int e = s->pieces - 1; e >= 0; e--) {
        const Piece *piece = &s->piece[e];
        double *x = step->local[e];
        for (int c = 0; c < piece->whole; c += 4) {
            Four sum = {0};
            for (int m = 0; m < STATE; m++) EACH(OF(sum) += ahead[m] * FOUR(piece->map[m] + c));
            EACH(FOUR(x + c) = OF(sum));
        }
        for (int i = 0; i < N; i++) {
            for (int b = 0; b < piece->count[i] && by->has_twist; b++)
                x[piece->first[i] + b] += by->twist[e][i * MOST_DEGREE + b];
            for (int a = 0; a < k && piece->count[i] == k; a++) {
                double pull = by->theta[e * k + a][i];
                for (int b = 0; b < k; b++) x[piece->first[i] + b] += pull * piece->turn[i][a][b];
                x[piece->rows + i] += pull;
            }
        }
        for (int b = 0; b < 2 * k; b++) x[piece->bend + b] += by->bend[e * k + b / 2][b % 2];
        for (int c = 0; c < k && by->has_orientation; c++) {
            const double *pull = by->orientation[e * k + c];
            for (int b = 0; b < 2 * k; b++)
                x[piece->bend + b] += s->soft[e * k + b / 2] * dot(pull, piece->own[c][b / 2][b % 2], 4);
            add_transposed(1, pull, piece->spread[c], x + piece->rows + N);
        }
        eliminate_forwards(piece->matrix, piece->rows, piece->whole, WIDTH, x);
        memcpy(ahead, x + piece->rows, sizeof ahead);
    }
    for (int i = 0; i < N; i++) {
        double sum = s->root_spring[i] * ahead[i] + (by->has_twist ? by->held[i] : 0);
        step->root[i] = (sum - dot(s->root[i], step->root, i)) / s->root[i][i];
    }
}

/* From the tip to the plate: step->local and ->root, whose squares sum to by' H^-1 by. */
static void sweep_back(const Stage *s, const Functional *by, Step *step) { BY_DEGREE(sweep_back_of, s, by, step); }

OF_DEGREE void sweep_forth_of(const Stage *s, Step *step, int turned, int k) {
    double here[STATE] = {0};
    for (int i = N - 1; i >= 0; i--) {
        double sum = -step->root[i];
        for (int j = i + 1; j < N; j++) sum -= s->root[j][i] * step->held[j];
        step->held[i] = sum / s->root[i][i];
        here[i] = s->root_spring[i] * step->held[i];
    }
    for (int e = 0; e < s->pieces; e++) {
        const Piece *piece = &s->piece[e];
        double *x = step->local[e], next[STATE];
        for (int r = 0; r < piece->rows; r++) x[r] = -x[r];
        memset(x + piece->rows, 0, (piece->whole - piece->rows) * sizeof(double));
        memcpy(x + piece->rows, here, sizeof here);
        eliminate_backwards(piece->matrix, piece->rows, piece->whole, WIDTH, x);
        for (int i = 0; i < N; i++) {
            memcpy(step->twist[e] + i * MOST_DEGREE, x + piece->first[i], piece->count[i] * sizeof(double));
            for (int a = 0; a < k; a++)
                step->theta[e * k + a][i] =
                    here[i] + (piece->count[i] == k ? dot(piece->turn[i][a], x + piece->first[i], k) : 0);
        }
        memcpy(step->bend[e * k], x + piece->bend, 2 * k * sizeof(double));
        for (int c = 0; c < k && turned; c++) {
            double *moved = step->orientation[e * k + c];
            product(here + N, piece->spread[c], moved);
            for (int b = 0; b < 2 * k; b++)
                EACH(FOUR(moved) += s->soft[e * k + b / 2] * x[piece->bend + b] * FOUR(piece->own[c][b / 2][b % 2]));
        }
        for (int m = 0; m < STATE; m++) next[m] = dot(piece->map[m], x, piece->whole);
        memcpy(here, next, sizeof here);
    }
}

/* From the plate to the tip: minus H^-1 by, and the change of theta and, if `turned`, of Q that it makes. */
static void sweep_forth(const Stage *s, Step *step, int turned) { BY_DEGREE(sweep_forth_of, s, step, turned); }
