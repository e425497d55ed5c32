/* Steps of ordinary length that a motion of rotations (n) and translations (n) takes, for an arm of a length. */
static double parts_of(const double *alpha, const double *shift, const double *to_alpha, const double *to_shift, double length) {
    double most = 1;
    for (int i = 0; i < N; i++) {
        most = fmax(most, fabs(to_alpha[i] - alpha[i]) / LARGEST_TURN);
        most = fmax(most, fabs(to_shift[i] - shift[i]) / (LARGEST_SHIFT * length));
    }
    return ceil(most - 1e-9);
}

