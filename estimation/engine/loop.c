/* Integration of one segment with variational sensitivities: see kernel.py. Included after the generated functions rates,
   rates_jacobian, rates_by_all, and the same of outputs (CasADi signature), and the constants NX NU NP NY NZ_* row_* col_*. */

#include <stdlib.h>
#include <string.h>

static int is_finite(double v) { return v - v == 0.0 && v < 1e12 && v > -1e12; }

enum { LANES = 8 }; /* rows of sensitivities are padded to full vectors, whose last columns stay zero */
typedef double Lanes __attribute__((vector_size(8 * LANES), aligned(8), may_alias));

typedef int (*Function)(const double **, double **, int *, double *, int);

static void call(Function function, const double *x, const double *u, const double *p, const double *h, double *r0, double *r1,
                 double *r2, double *r3) {
    const double *arg[WORK];
    double *res[WORK];
    double w[WORK];
    int iw[WORK];
    arg[0] = x; arg[1] = u; arg[2] = p; arg[3] = h;
    res[0] = r0; res[1] = r1; res[2] = r2; res[3] = r3;
    function(arg, res, iw, w, 0);
}

/* Non-zeros of a derivative that some column needs: value[from] (times du[by], of input transforms) is added at `to`. */
typedef struct {
    int count;
    int *from, *to, *by;
} Entries;

static void add(const Entries *e, const double *restrict value, double *restrict to) {
    for (int i = 0; i < e->count; ++i) to[e->to[i]] += value[e->from[i]];
}

static void add_driven(const Entries *e, const double *restrict value, const double *restrict du, double *restrict to) {
    for (int i = 0; i < e->count; ++i) to[e->to[i]] += value[e->from[i]] * du[e->by[i]];
}

/* Terms of the rates that depend on inputs and parameters only: a step needs them at three instants, not at every stage. */
typedef struct {
    double start[HOISTED], middle[HOISTED], end[HOISTED];
} Hoisted;

static void hoist(Function function, const double *u, const double *p, double *h) {
    call(function, u, p, 0, 0, h, 0, 0, 0);
}

/* n sensitivity columns in rows of `stride` doubles, nt input transforms, and the derivatives that these need */
typedef struct {
    int n, stride, nt;
    Entries f_p, y_p, f_u, y_u;
} Plan;

static void by_parameter(Entries *e, int count, const int *row, const int *col, const int *parameter, int stride) {
    for (int z = 0; z < count; ++z) {
        const int j = parameter[col[z]];
        if (j < 0) continue;
        e->from[e->count] = z;
        e->to[e->count++] = row[z] * stride + j;
    }
}

static void by_transform(Entries *e, int count, const int *row, const int *col, const int *transform, int nt,
                         const char *driven, int stride) {
    for (int t = 0; t < nt; ++t)
        for (int z = 0; z < count; ++z) {
            const int at = col[z] * nt + t;
            if (transform[t] < 0 || !driven[at]) continue;
            e->from[e->count] = z;
            e->by[e->count] = at;
            e->to[e->count++] = row[z] * stride + transform[t];
        }
}

/* which of the (NU, nt) derivatives of the inputs are ever other than zero */
static void find_driven(size_t count, int width, const double *du, char *driven) {
    for (size_t k = 0; k < count; ++k)
        for (int i = 0; i < width; ++i)
            if (du[k * width + i] != 0.0) driven[i] = 1;
}

/* k += A s, A given by its non-zeros */
static void through_states(int count, const int *row, const int *col, const double *restrict value, int stride,
                           const double *restrict s, double *restrict k) {
    for (int z = 0; z < count; ++z) {
        const double a = value[z];
        const double *restrict from = s + col[z] * stride;
        double *restrict to = k + row[z] * stride;
        for (int j = 0; j < stride; ++j) to[j] += a * from[j];
    }
}

/* K = f_x S + f_p (free columns) + f_u du (transform columns) at the point S of a stage; then adds w K to the sum `sn` of the step
   and moves to the point of the next stage, s + c K. A vector of columns at a time: K stays in registers. */
static void variation(const Plan *plan, const double *fx, const double *fu, const double *fp, const double *du, double w,
                      double c, const double *restrict s, double *restrict k, double *restrict point, double *restrict sn) {
    memset(k, 0, sizeof(double) * NX * plan->stride);
    add(&plan->f_p, fp, k);
    if (plan->nt > 0) add_driven(&plan->f_u, fu, du, k);
    for (int j = 0; j < plan->stride; j += LANES) {
        Lanes from[NX], to[NX];
        for (int a = 0; a < NX; ++a) {
            from[a] = *(const Lanes *)(point + a * plan->stride + j);
            to[a] = *(const Lanes *)(k + a * plan->stride + j);
        }
#pragma GCC unroll 256
        for (int z = 0; z < NZ_f_x; ++z) to[row_f_x[z]] += fx[z] * from[col_f_x[z]];
        for (int a = 0; a < NX; ++a) {
            const int at = a * plan->stride + j;
            *(Lanes *)(sn + at) += w * to[a];
            *(Lanes *)(point + at) = *(const Lanes *)(s + at) + c * to[a];
        }
    }
}

/* Input at a fraction of the interval: straight from a to m half-way, straight on to b. */
static void blend(int size, double at, const double *a, const double *m, const double *b, double *to) {
    const double *from = at < 0.5 ? a : m, *next = at < 0.5 ? m : b;
    const double part = at < 0.5 ? 2.0 * at : 2.0 * at - 1.0;
    for (int i = 0; i < size; ++i) to[i] = from[i] + part * (next[i] - from[i]);
}

/* y and its sensitivities dy, rows of `stride` */
static void outputs_with(const Plan *plan, const double *x, const double *u, const double *p, const double *s,
                         const double *du, double *y, double *dy) {
    double yx[NZ_y_x + 1], yu[NZ_y_u + 1], yp[NZ_y_p + 1];
    if (plan->nt > 0) call(outputs_by_all, x, u, p, 0, y, yx, yp, yu);
    else call(outputs_jacobian, x, u, p, 0, y, yx, yp, 0);
    memset(dy, 0, sizeof(double) * NY * plan->stride);
    through_states(NZ_y_x, row_y_x, col_y_x, yx, plan->stride, s, dy);
    add(&plan->y_p, yp, dy);
    if (plan->nt > 0) add_driven(&plan->y_u, yu, du, dy);
}

/* x += K (z - y), S += dK (z - y) - K dy; samples of z that are NaN correct nothing */
static void correct(int n, int stride, const double *gain, const int *gain_column, const double *z, const double *y,
                    const double *dy, double *x, double *s) {
    for (int c = 0; c < NY; ++c) {
        const double e = z[c] - y[c];
        if (e != e) continue;
        for (int i = 0; i < NX; ++i) {
            const double g = gain[i * NY + c];
            x[i] += g * e;
            if (n > 0) {
                for (int j = 0; j < n; ++j) s[i * stride + j] -= g * dy[c * stride + j];
                const int j = gain_column[i * NY + c];
                if (j >= 0) s[i * stride + j] += e;
            }
        }
    }
}

/* One Runge-Kutta step of length h from inputs ua (start), um (middle), ub (end). */
static void step(const Plan *plan, double h, const double *ua, const double *um, const double *ub, const double *da,
                 const double *dm, const double *db, const double *p, const Hoisted *hoisted, double *x, double *s,
                 double *buffer) {
    static const double part[4] = {0.0, 0.5, 0.5, 1.0};
    static const double weight[4] = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6};
    const double *us[4], *ds[4], *hs[4];
    us[0] = ua; us[1] = um; us[2] = um; us[3] = ub;
    hs[0] = hoisted->start; hs[1] = hoisted->middle; hs[2] = hoisted->middle; hs[3] = hoisted->end;
    ds[0] = da; ds[1] = dm; ds[2] = dm; ds[3] = db;
    const int size = NX * plan->stride;
    double f[NX], xs[NX], xn[NX], fx[NZ_f_x + 1], fu[NZ_f_u + 1], fp[NZ_f_p + 1];
    double *restrict k = buffer, *restrict point = buffer + size, *restrict sn = buffer + 2 * size;
    memcpy(xn, x, sizeof(double) * NX);
    if (size > 0) {
        memcpy(point, s, sizeof(double) * size);
        memcpy(sn, s, sizeof(double) * size);
    }
    for (int i = 0; i < 4; ++i) {
        for (int a = 0; a < NX; ++a) xs[a] = i == 0 ? x[a] : x[a] + h * part[i] * f[a];
        if (size > 0) {
            if (plan->nt > 0) call(rates_by_all, xs, us[i], p, hs[i], f, fx, fp, fu);
            else call(rates_jacobian, xs, us[i], p, hs[i], f, fx, fp, 0);
            variation(plan, fx, fu, fp, ds[i], h * weight[i], i < 3 ? h * part[i + 1] : 0.0, s, k, point, sn);
        } else {
            call(rates, xs, us[i], p, hs[i], f, 0, 0, 0);
        }
        for (int a = 0; a < NX; ++a) xn[a] += h * weight[i] * f[a];
    }
    memcpy(x, xn, sizeof(double) * NX);
    if (size > 0) memcpy(s, sn, sizeof(double) * size);
}

/* Returns the number of samples before the motion diverged (N where it did not). */
int integrate(int count, int substeps, int n, int nt, const double *dt, const double *u, const double *u_mid,
              const double *u_end, const double *du, const double *du_mid, const double *du_end, const double *p,
              const double *x0, const int *parameter, const int *state, const int *transform, const int *gain_column,
              const double *gain, const double *z, double *x_out, double *y_out, double *dy_out) {
    double x[NX], ua[NU + 1], um[NU + 1], ub[NU + 1];
    Hoisted hoisted;
    const Function before = n == 0 ? rates_before : nt > 0 ? rates_by_all_before : rates_jacobian_before;
    const int stride = (n + LANES - 1) / LANES * LANES, size = NX * stride, width = n > 0 ? NU * nt : 0;
    const int most = n > 0 ? NZ_f_p + NZ_y_p + nt * (NZ_f_u + NZ_y_u) : 0;
    double *memory = (double *)calloc((size_t)(4 * size + 3 * width + NY * stride + 1), sizeof(double));
    int *places = (int *)calloc((size_t)(3 * most + 1), sizeof(int));
    char *driven = (char *)calloc((size_t)(width + 1), 1);
    int reached = count;
    if (!memory || !places || !driven) {
        free(memory); free(places); free(driven);
        return 0;
    }
    double *s = memory, *buffer = memory + size, *dy = memory + 4 * size;
    double *da = dy + NY * stride, *dm = da + width, *db = dm + width;
    Plan plan = {.n = n, .stride = stride, .nt = n > 0 ? nt : 0};
    Entries *const entries[4] = {&plan.f_p, &plan.y_p, &plan.f_u, &plan.y_u};
    const int room[4] = {NZ_f_p, NZ_y_p, nt * NZ_f_u, nt * NZ_y_u};
    for (int i = 0, at = 0; i < 4; at += room[i++]) {
        entries[i]->from = places + at;
        entries[i]->to = places + most + at;
        entries[i]->by = places + 2 * most + at;
    }
    if (n > 0) {
        by_parameter(&plan.f_p, NZ_f_p, row_f_p, col_f_p, parameter, stride);
        by_parameter(&plan.y_p, NZ_y_p, row_y_p, col_y_p, parameter, stride);
        find_driven((size_t)count, width, du, driven);
        find_driven((size_t)count, width, du_mid, driven);
        find_driven((size_t)count, width, du_end, driven);
        by_transform(&plan.f_u, NZ_f_u, row_f_u, col_f_u, transform, nt, driven, stride);
        by_transform(&plan.y_u, NZ_y_u, row_y_u, col_y_u, transform, nt, driven, stride);
        for (int i = 0; i < NX; ++i)
            if (state[i] >= 0) s[i * stride + state[i]] = 1.0;
    }
    memcpy(x, x0, sizeof(double) * NX);
    for (int k = 0; k < count; ++k) {
        double *y = y_out + (size_t)k * NY;
        for (int i = 0; i < NX; ++i)
            if (!is_finite(x[i])) reached = k;
        if (reached == k) break;
        if (n > 0) {
            outputs_with(&plan, x, u + (size_t)k * NU, p, s, du + (size_t)k * width, y, dy);
            for (int c = 0; c < NY; ++c)
                memcpy(dy_out + ((size_t)k * NY + c) * n, dy + c * stride, sizeof(double) * n);
        } else {
            call(outputs, x, u + (size_t)k * NU, p, 0, y, 0, 0, 0);
        }
        if (gain) correct(n, stride, gain, gain_column, z + (size_t)k * NY, y, dy, x, s);
        memcpy(x_out + (size_t)k * NX, x, sizeof(double) * NX);
        if (k + 1 == count) break;
        const double h = dt[k] / substeps;
        const double *ua0 = u + (size_t)k * NU, *um0 = u_mid + (size_t)k * NU, *ub0 = u_end + (size_t)k * NU;
        const double *da0 = du + (size_t)k * width, *dm0 = du_mid + (size_t)k * width, *db0 = du_end + (size_t)k * width;
        for (int j = 0; j < substeps; ++j) {
            const double at = (double)j / substeps;
            blend(NU, at, ua0, um0, ub0, ua);
            if ((k > 0 || j > 0) && memcmp(ua, ub, sizeof(double) * NU) == 0) /* the last step ended with these inputs */
                memcpy(hoisted.start, hoisted.end, sizeof hoisted.start);
            else
                hoist(before, ua, p, hoisted.start);
            blend(NU, at + 0.5 / substeps, ua0, um0, ub0, um);
            blend(NU, at + 1.0 / substeps, ua0, um0, ub0, ub);
            hoist(before, um, p, hoisted.middle);
            hoist(before, ub, p, hoisted.end);
            if (width > 0) {
                blend(width, at, da0, dm0, db0, da);
                blend(width, at + 0.5 / substeps, da0, dm0, db0, dm);
                blend(width, at + 1.0 / substeps, da0, dm0, db0, db);
            }
            step(&plan, h, ua, um, ub, da, dm, db, p, &hoisted, x, s, buffer);
        }
    }
    for (int k = reached; k < count; ++k) {
        for (int i = 0; i < NX; ++i) x_out[(size_t)k * NX + i] = 0.0;
        for (int c = 0; c < NY; ++c) y_out[(size_t)k * NY + c] = 0.0;
        for (int j = 0; j < NY * n; ++j) dy_out[(size_t)k * NY * n + j] = 0.0;
    }
    free(memory);
    free(places);
    free(driven);
    return reached;
}

/* Rates, outputs and their parameter derivatives at given states: the regressors of equation error. */
void pointwise(int count, const double *x, const double *u, const double *p, double *f, double *fp, double *y,
               double *yp) {
    double fx[NZ_f_x + 1], fpz[NZ_f_p + 1], yx[NZ_y_x + 1], ypz[NZ_y_p + 1], h[HOISTED];
    memset(fp, 0, sizeof(double) * (size_t)count * NX * NP);
    memset(yp, 0, sizeof(double) * (size_t)count * NY * NP);
    for (int k = 0; k < count; ++k) {
        const double *xk = x + (size_t)k * NX, *uk = u + (size_t)k * NU;
        hoist(rates_jacobian_before, uk, p, h);
        call(rates_jacobian, xk, uk, p, h, f + (size_t)k * NX, fx, fpz, 0);
        call(outputs_jacobian, xk, uk, p, 0, y + (size_t)k * NY, yx, ypz, 0);
        for (int z = 0; z < NZ_f_p; ++z) fp[((size_t)k * NX + row_f_p[z]) * NP + col_f_p[z]] = fpz[z];
        for (int z = 0; z < NZ_y_p; ++z) yp[((size_t)k * NY + row_y_p[z]) * NP + col_y_p[z]] = ypz[z];
    }
}
