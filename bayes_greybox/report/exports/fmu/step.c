/*
 * What goes on between two communication points of a Co-Simulation: Dormand and Prince's pair of orders 5 and 4
 * (Journal of Computational and Applied Mathematics 6, 1980, table 2), inputs held as FMI 2.0 has them.
 */
#define STAGES 7
#define TOLERANCE 1e-8

/* No importer's tolerance is taken for less: rounding would then refuse every step. */
#define TIGHTEST 1e-14

/* A step of this share of the whole is taken whatever its error, as across a jump of dry friction: that a mass sticks
   would else take steps without end. */
#define SMALLEST 1e-4

/* Beyond this share of a state's largest value the error of such a step is told. */
#define LOOSE 1e-2

static const double NODE[STAGES] = {0.0, 1.0 / 5, 3.0 / 10, 4.0 / 5, 8.0 / 9, 1.0, 1.0};
static const double WEIGHT[STAGES][STAGES - 1] = {
    {0.0},
    {1.0 / 5},
    {3.0 / 40, 9.0 / 40},
    {44.0 / 45, -56.0 / 15, 32.0 / 9},
    {19372.0 / 6561, -25360.0 / 2187, 64448.0 / 6561, -212.0 / 729},
    {9017.0 / 3168, -355.0 / 33, 46732.0 / 5247, 49.0 / 176, -5103.0 / 18656},
    {35.0 / 384, 0.0, 500.0 / 1113, 125.0 / 192, -2187.0 / 6784, 11.0 / 84}};
/* Of order 5 less that of order 4. */
static const double ERROR[STAGES] = {71.0 / 57600, 0.0, -71.0 / 16695, 71.0 / 1920, -17253.0 / 339200, 22.0 / 525,
                                     -1.0 / 40};

/* One step of length h, `gone` after the communication point, to `to`; returns its error over what is allowed. */
static double tried(Model *m, double gone, double h, double rate[STAGES][N_STATE + 1], double *to)
{
    double worst = 0.0;
    size_t i, j, s;
    RHS(m->time + gone, m->value, m->value + INPUTS, m->value + FACTORS, rate[0]);
    for (s = 1; s < STAGES; s++) {
        for (i = 0; i < N_STATE; i++) {
            double sum = 0.0;
            for (j = 0; j < s; j++) sum += WEIGHT[s][j] * rate[j][i];
            to[i] = m->value[i] + h * sum;
        }
        RHS(m->time + gone + NODE[s] * h, to, m->value + INPUTS, m->value + FACTORS, rate[s]);
    }
    for (i = 0; i < N_STATE; i++) {
        double off = 0.0, size = fmax(m->largest[i], fabs(to[i]));
        for (s = 0; s < STAGES; s++) off += ERROR[s] * rate[s][i];
        off = fabs(h * off);
        if (!isfinite(off) || !isfinite(to[i])) return INFINITY;
        /* What has been at zero all along, and is there again, has no size to be compared with. */
        if (off > 0.0 && size > 0.0) worst = fmax(worst, off / size / m->tolerance);
    }
    return worst;
}

/* The states a communication step later; a warning where they are rough, an error where they are none. */
static fmi2Status advance(Model *m, double length)
{
    const double least = SMALLEST * length > 0.0 ? SMALLEST * length : length;
    double rate[STAGES][N_STATE + 1], to[N_STATE + 1], gone = 0.0, h = fmin(fmax(m->step, least), length);
    fmi2Status status = fmi2OK;
    size_t i;
    for (i = 0; i < N_STATE; i++) m->largest[i] = fmax(m->largest[i], fabs(m->value[i]));
    /* Counted from the communication point: far from zero, time itself has no digits for short steps. */
    while (gone < length) {
        const int last = gone + 1.001 * h >= length;
        const double step = last ? length - gone : h;
        const double off = tried(m, gone, step, rate, to);
        const double factor = off > 0.0 ? fmin(5.0, fmax(0.2, 0.9 * pow(off, -0.2))) : 5.0;
        /* Wider than what the last step may have more than the least. */
        if (off > 1.0 && step > 1.01 * least) {
            h = fmax(least, step * factor);
            continue;
        }
        if (!(off < INFINITY)) return fmi2Error;
        memcpy(m->value, to, N_STATE * sizeof(double));
        if (off <= 1.0)
            for (i = 0; i < N_STATE; i++) m->largest[i] = fmax(m->largest[i], fabs(to[i]));
        else if (off * m->tolerance > LOOSE)
            status = fmi2Warning;
        gone = last ? length : gone + step;
        /* A short last step says nothing of longer ones. */
        h = fmax(least, last ? fmax(h, step * factor) : step * factor);
    }
    m->step = h;
    return status;
}
