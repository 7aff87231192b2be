/* Integration of one segment with variational sensitivities: see kernel.py. Included after the generated functions
   rates, rates_jacobian, rates_by_input, and the same of outputs (CasADi signature) and the constants NX NU NP NY NZ_* row_* col_*. */

#include <stdlib.h>
#include <string.h>

static int is_finite(double v) { return v - v == 0.0 && v < 1e12 && v > -1e12; }

static void call(int (*function)(const double **, double **, int *, double *, int),
                 const double *x, const double *u, const double *p, double *r0, double *r1, double *r2) {
    const double *arg[WORK];
    double *res[WORK];
    double w[WORK];
    int iw[WORK];
    arg[0] = x; arg[1] = u; arg[2] = p;
    res[0] = r0; res[1] = r1; res[2] = r2;
    function(arg, res, iw, w, 0);
}

/* K = f_x S + f_p (free columns) + f_u du (transform columns) */
static void variation(int n, int nt, const int *restrict parameter, const int *restrict transform,
                      const double *restrict fx, const double *restrict fu, const double *restrict fp,
                      const double *restrict s, const double *restrict du, double *restrict k) {
    memset(k, 0, sizeof(double) * NX * n);
    for (int z = 0; z < NZ_f_x; ++z) {
        const double a = fx[z];
        const double *restrict from = s + col_f_x[z] * n;
        double *restrict to = k + row_f_x[z] * n;
        for (int j = 0; j < n; ++j) to[j] += a * from[j];
    }
    for (int z = 0; z < NZ_f_p; ++z) {
        const int j = parameter[col_f_p[z]];
        if (j >= 0) k[row_f_p[z] * n + j] += fp[z];
    }
    for (int t = 0; t < nt; ++t) {
        const int j = transform[t];
        if (j < 0) continue;
        for (int z = 0; z < NZ_f_u; ++z) k[row_f_u[z] * n + j] += fu[z] * du[col_f_u[z] * nt + t];
    }
}

/* Input at a fraction of the interval: straight from a to m half-way, straight on to b. */
static void blend(int size, double at, const double *a, const double *m, const double *b, double *to) {
    const double *from = at < 0.5 ? a : m, *next = at < 0.5 ? m : b;
    const double part = at < 0.5 ? 2.0 * at : 2.0 * at - 1.0;
    for (int i = 0; i < size; ++i) to[i] = from[i] + part * (next[i] - from[i]);
}

static void outputs_with(int n, int nt, const int *parameter, const int *transform, const double *x, const double *u,
                         const double *p, const double *s, const double *du, double *y, double *dy) {
    double yx[NZ_y_x + 1], yu[NZ_y_u + 1], yp[NZ_y_p + 1];
    call(outputs_jacobian, x, u, p, y, yx, yp);
    if (nt > 0) call(outputs_by_input, x, u, p, yu, 0, 0);
    memset(dy, 0, sizeof(double) * NY * n);
    for (int z = 0; z < NZ_y_x; ++z) {
        const double a = yx[z];
        const double *restrict from = s + col_y_x[z] * n;
        double *restrict to = dy + row_y_x[z] * n;
        for (int j = 0; j < n; ++j) to[j] += a * from[j];
    }
    for (int z = 0; z < NZ_y_p; ++z) {
        const int j = parameter[col_y_p[z]];
        if (j >= 0) dy[row_y_p[z] * n + j] += yp[z];
    }
    for (int t = 0; t < nt; ++t) {
        const int j = transform[t];
        if (j < 0) continue;
        for (int z = 0; z < NZ_y_u; ++z) dy[row_y_u[z] * n + j] += yu[z] * du[col_y_u[z] * nt + t];
    }
}

/* x += K (z - y), S += dK (z - y) - K dy; samples of z that are NaN correct nothing */
static void correct(int n, const double *gain, const int *gain_column, const double *z, const double *y,
                    const double *dy, double *x, double *s) {
    for (int c = 0; c < NY; ++c) {
        const double e = z[c] - y[c];
        if (e != e) continue;
        for (int i = 0; i < NX; ++i) {
            const double g = gain[i * NY + c];
            x[i] += g * e;
            if (n > 0) {
                for (int j = 0; j < n; ++j) s[i * n + j] -= g * dy[c * n + j];
                const int j = gain_column[i * NY + c];
                if (j >= 0) s[i * n + j] += e;
            }
        }
    }
}

/* One Runge-Kutta step of length h from inputs ua (start), um (middle), ub (end). */
static void step(int n, int nt, const int *parameter, const int *transform, double h, const double *ua,
                 const double *um, const double *ub, const double *da, const double *dm, const double *db,
                 const double *p, double *x, double *s, double *buffer) {
    static const double part[4] = {0.0, 0.5, 0.5, 1.0};
    static const double weight[4] = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6};
    const double *us[4], *ds[4];
    us[0] = ua; us[1] = um; us[2] = um; us[3] = ub;
    ds[0] = da; ds[1] = dm; ds[2] = dm; ds[3] = db;
    const int size = NX * n;
    double f[NX], xs[NX], xn[NX], fx[NZ_f_x + 1], fu[NZ_f_u + 1], fp[NZ_f_p + 1];
    double *k = buffer, *ss = buffer + size, *sn = buffer + 2 * size;
    memcpy(xn, x, sizeof(double) * NX);
    if (n > 0) memcpy(sn, s, sizeof(double) * size);
    for (int i = 0; i < 4; ++i) {
        for (int a = 0; a < NX; ++a) xs[a] = i == 0 ? x[a] : x[a] + h * part[i] * f[a];
        if (n > 0) {
            const double c = h * part[i];
            if (i == 0) memcpy(ss, s, sizeof(double) * size);
            else for (int a = 0; a < size; ++a) ss[a] = s[a] + c * k[a];
            call(rates_jacobian, xs, us[i], p, f, fx, fp);
            if (nt > 0) call(rates_by_input, xs, us[i], p, fu, 0, 0);
            variation(n, nt, parameter, transform, fx, fu, fp, ss, ds[i], k);
            const double w = h * weight[i];
            for (int a = 0; a < size; ++a) sn[a] += w * k[a];
        } else {
            call(rates, xs, us[i], p, f, 0, 0);
        }
        for (int a = 0; a < NX; ++a) xn[a] += h * weight[i] * f[a];
    }
    memcpy(x, xn, sizeof(double) * NX);
    if (n > 0) memcpy(s, sn, sizeof(double) * size);
}

/* Returns the number of samples reached before the motion left the finite numbers (N where it never did). */
int integrate(int count, int substeps, int n, int nt, const double *dt, const double *u, const double *u_mid,
              const double *u_end, const double *du, const double *du_mid, const double *du_end, const double *p,
              const double *x0, const int *parameter, const int *state, const int *transform, const int *gain_column,
              const double *gain, const double *z, double *x_out, double *y_out, double *dy_out) {
    double x[NX], ua[NU + 1], um[NU + 1], ub[NU + 1];
    const int size = NX * n, width = NU * nt;
    double *memory = (double *)calloc((size_t)(4 * size + 3 * width + 1), sizeof(double));
    double *s = memory, *buffer = memory + size, *da = memory + 4 * size, *dm = da + width, *db = dm + width;
    int reached = count;
    if (!memory) return 0;
    memcpy(x, x0, sizeof(double) * NX);
    if (n > 0)
        for (int i = 0; i < NX; ++i)
            if (state[i] >= 0) s[i * n + state[i]] = 1.0;
    for (int k = 0; k < count; ++k) {
        double *y = y_out + (size_t)k * NY, *dy = dy_out + (size_t)k * NY * n;
        for (int i = 0; i < NX; ++i)
            if (!is_finite(x[i])) reached = k;
        if (reached == k) break;
        if (n > 0)
            outputs_with(n, nt, parameter, transform, x, u + (size_t)k * NU, p, s, du + (size_t)k * width, y, dy);
        else
            call(outputs, x, u + (size_t)k * NU, p, y, 0, 0);
        if (gain) correct(n, gain, gain_column, z + (size_t)k * NY, y, dy, x, s);
        memcpy(x_out + (size_t)k * NX, x, sizeof(double) * NX);
        if (k + 1 == count) break;
        const double h = dt[k] / substeps;
        const double *ua0 = u + (size_t)k * NU, *um0 = u_mid + (size_t)k * NU, *ub0 = u_end + (size_t)k * NU;
        const double *da0 = du + (size_t)k * width, *dm0 = du_mid + (size_t)k * width, *db0 = du_end + (size_t)k * width;
        for (int j = 0; j < substeps; ++j) {
            const double at = (double)j / substeps;
            blend(NU, at, ua0, um0, ub0, ua);
            blend(NU, at + 0.5 / substeps, ua0, um0, ub0, um);
            blend(NU, at + 1.0 / substeps, ua0, um0, ub0, ub);
            if (width > 0) {
                blend(width, at, da0, dm0, db0, da);
                blend(width, at + 0.5 / substeps, da0, dm0, db0, dm);
                blend(width, at + 1.0 / substeps, da0, dm0, db0, db);
            }
            step(n, nt, parameter, transform, h, ua, um, ub, da, dm, db, p, x, s, buffer);
        }
    }
    for (int k = reached; k < count; ++k) {
        for (int i = 0; i < NX; ++i) x_out[(size_t)k * NX + i] = 0.0;
        for (int c = 0; c < NY; ++c) y_out[(size_t)k * NY + c] = 0.0;
        for (int j = 0; j < NY * n; ++j) dy_out[(size_t)k * NY * n + j] = 0.0;
    }
    free(memory);
    return reached;
}

/* Rates, outputs and their parameter derivatives at given states: the regressors of equation error. */
void pointwise(int count, const double *x, const double *u, const double *p, double *f, double *fp, double *y,
               double *yp) {
    double fx[NZ_f_x + 1], fpz[NZ_f_p + 1], yx[NZ_y_x + 1], ypz[NZ_y_p + 1];
    memset(fp, 0, sizeof(double) * (size_t)count * NX * NP);
    memset(yp, 0, sizeof(double) * (size_t)count * NY * NP);
    for (int k = 0; k < count; ++k) {
        const double *xk = x + (size_t)k * NX, *uk = u + (size_t)k * NU;
        call(rates_jacobian, xk, uk, p, f + (size_t)k * NX, fx, fpz);
        call(outputs_jacobian, xk, uk, p, y + (size_t)k * NY, yx, ypz);
        for (int z = 0; z < NZ_f_p; ++z) fp[((size_t)k * NX + row_f_p[z]) * NP + col_f_p[z]] = fpz[z];
        for (int z = 0; z < NZ_y_p; ++z) yp[((size_t)k * NY + row_y_p[z]) * NP + col_y_p[z]] = ypz[z];
    }
}
