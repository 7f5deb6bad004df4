//! Small dense linear algebra on slices, for kernels that solve one little system per point.

/// Eigenvalues (ascending) and eigenvectors of a symmetric matrix of order `n`, row after row: Householder reduction to
/// tridiagonal form, then implicit QL (Bowdler, Martin, Reinsch, Wilkinson 1968). On return column k of `a` is the
/// eigenvector of `values[k]`. `false` if an entry is not finite or the iteration did not end.
pub(crate) fn symmetric_eigen(a: &mut [f64], n: usize, values: &mut [f64], work: &mut [f64]) -> bool {
    if n == 0 || a[..n * n].iter().any(|number| !number.is_finite()) {
        return n == 0;
    }
    tridiagonalize(a, n, values, work);
    implicit_ql(a, n, values, work)
}

fn tridiagonalize(v: &mut [f64], n: usize, d: &mut [f64], e: &mut [f64]) {
    d[..n].copy_from_slice(&v[(n - 1) * n..n * n]);
    for i in (1..n).rev() {
        let scale: f64 = d[..i].iter().map(|x| x.abs()).sum();
        let mut h = 0.0;
        if scale == 0.0 {
            e[i] = d[i - 1];
            for j in 0..i {
                d[j] = v[(i - 1) * n + j];
                v[i * n + j] = 0.0;
                v[j * n + i] = 0.0;
            }
        } else {
            for x in &mut d[..i] {
                *x /= scale;
                h += *x * *x;
            }
            let f = d[i - 1];
            let g = if f > 0.0 { -h.sqrt() } else { h.sqrt() };
            e[i] = scale * g;
            h -= f * g;
            d[i - 1] = f - g;
            e[..i].fill(0.0);
            for j in 0..i {
                let f = d[j];
                v[j * n + i] = f;
                let mut g = e[j] + v[j * n + j] * f;
                for k in j + 1..i {
                    g += v[k * n + j] * d[k];
                    e[k] += v[k * n + j] * f;
                }
                e[j] = g;
            }
            let mut f = 0.0;
            for j in 0..i {
                e[j] /= h;
                f += e[j] * d[j];
            }
            let hh = f / (h + h);
            for j in 0..i {
                e[j] -= hh * d[j];
            }
            for j in 0..i {
                let (f, g) = (d[j], e[j]);
                for k in j..i {
                    v[k * n + j] -= f * e[k] + g * d[k];
                }
                d[j] = v[(i - 1) * n + j];
                v[i * n + j] = 0.0;
            }
        }
        d[i] = h;
    }
    for i in 0..n - 1 {
        v[(n - 1) * n + i] = v[i * n + i];
        v[i * n + i] = 1.0;
        let h = d[i + 1];
        if h != 0.0 {
            for k in 0..=i {
                d[k] = v[k * n + i + 1] / h;
            }
            for j in 0..=i {
                let g: f64 = (0..=i).map(|k| v[k * n + i + 1] * v[k * n + j]).sum();
                for k in 0..=i {
                    v[k * n + j] -= g * d[k];
                }
            }
        }
        for k in 0..=i {
            v[k * n + i + 1] = 0.0;
        }
    }
    for j in 0..n {
        d[j] = v[(n - 1) * n + j];
        v[(n - 1) * n + j] = 0.0;
    }
    v[n * n - 1] = 1.0;
    e[0] = 0.0;
}

fn implicit_ql(v: &mut [f64], n: usize, d: &mut [f64], e: &mut [f64]) -> bool {
    e.copy_within(1..n, 0);
    e[n - 1] = 0.0;
    let (mut f, mut tst1) = (0.0, 0.0f64);
    for l in 0..n {
        tst1 = tst1.max(d[l].abs() + e[l].abs());
        let m = (l..n).find(|&m| e[m].abs() <= f64::EPSILON * tst1).unwrap_or(n - 1);
        if m > l {
            let mut rounds = 0;
            loop {
                rounds += 1;
                if rounds > 60 {
                    return false;
                }
                let g = d[l];
                let p = (d[l + 1] - g) / (2.0 * e[l]);
                let r = if p < 0.0 { -p.hypot(1.0) } else { p.hypot(1.0) };
                d[l] = e[l] / (p + r);
                d[l + 1] = e[l] * (p + r);
                let dl1 = d[l + 1];
                let h = g - d[l];
                for x in &mut d[l + 2..n] {
                    *x -= h;
                }
                f += h;
                let mut p = d[m];
                let (mut c, mut c2, mut c3) = (1.0, 1.0, 1.0);
                let el1 = e[l + 1];
                let (mut s, mut s2) = (0.0, 0.0);
                for i in (l..m).rev() {
                    c3 = c2;
                    c2 = c;
                    s2 = s;
                    let g = c * e[i];
                    let h = c * p;
                    let r = p.hypot(e[i]);
                    e[i + 1] = s * r;
                    s = e[i] / r;
                    c = p / r;
                    p = c * d[i] - s * g;
                    d[i + 1] = h + s * (c * g + s * d[i]);
                    for k in 0..n {
                        let h = v[k * n + i + 1];
                        v[k * n + i + 1] = s * v[k * n + i] + c * h;
                        v[k * n + i] = c * v[k * n + i] - s * h;
                    }
                }
                p = -s * s2 * c3 * el1 * e[l] / dl1;
                e[l] = s * p;
                d[l] = c * p;
                if e[l].abs() <= f64::EPSILON * tst1 {
                    break;
                }
            }
        }
        d[l] += f;
        e[l] = 0.0;
    }
    for i in 0..n.saturating_sub(1) {
        let k = (i..n).fold(i, |best, j| if d[j] < d[best] { j } else { best });
        if k != i {
            d.swap(i, k);
            for j in 0..n {
                v.swap(j * n + i, j * n + k);
            }
        }
    }
    d[..n].iter().all(|x| x.is_finite())
}

/// Overwrites the lower triangle of a symmetric positive definite matrix of order `n` by its Cholesky factor. `false` if a
/// pivot falls below `floor` times the diagonal entry it came from: the columns are then dependent to that accuracy.
pub(crate) fn cholesky(a: &mut [f64], n: usize, floor: f64) -> bool {
    for i in 0..n {
        for j in 0..=i {
            let mut sum = a[i * n + j];
            for k in 0..j {
                sum -= a[i * n + k] * a[j * n + k];
            }
            if i == j {
                if sum.is_nan() || sum <= floor * a[i * n + i] {
                    return false;
                }
                a[i * n + i] = sum.sqrt();
            } else {
                a[i * n + j] = sum / a[j * n + j];
            }
        }
    }
    true
}

/// Solves with the factor of [`cholesky`], in place.
pub(crate) fn cholesky_solve(l: &[f64], n: usize, x: &mut [f64]) {
    for i in 0..n {
        let mut sum = x[i];
        for k in 0..i {
            sum -= l[i * n + k] * x[k];
        }
        x[i] = sum / l[i * n + i];
    }
    for i in (0..n).rev() {
        let mut sum = x[i];
        for k in i + 1..n {
            sum -= l[k * n + i] * x[k];
        }
        x[i] = sum / l[i * n + i];
    }
}

/// The monomials of degree at most `degree` in `variables` variables, by degree: 1, x, y, x², xy, y², ...
#[derive(Debug, Clone)]
pub(crate) struct Monomials {
    /// Each monomial after the first: an earlier one, times a variable.
    factors: Vec<(usize, usize)>,
    variables: usize,
}

impl Monomials {
    pub(crate) fn new(variables: usize, degree: usize) -> Self {
        let mut factors = vec![];
        let mut last: Vec<(usize, usize)> = vec![(0, 0)]; // monomials of the degree before: index, first variable to multiply by
        let mut count = 1;
        for _ in 0..degree {
            let mut next = vec![];
            for &(parent, first) in &last {
                for variable in first..variables {
                    factors.push((parent, variable));
                    next.push((count, variable));
                    count += 1;
                }
            }
            last = next;
        }
        Monomials { factors, variables }
    }

    /// How many there are.
    pub(crate) fn len(&self) -> usize {
        self.factors.len() + 1
    }

    /// Their values at `x`.
    #[inline]
    pub(crate) fn evaluate(&self, x: &[f64], out: &mut [f64]) {
        out[0] = 1.0;
        for (at, &(parent, variable)) in self.factors.iter().enumerate() {
            out[at + 1] = out[parent] * x[variable];
        }
    }

    /// The index of x_a x_b.
    pub(crate) fn second(&self, a: usize, b: usize) -> usize {
        let (low, high) = if a < b { (a, b) } else { (b, a) };
        // rows of the upper triangle, after 1 and the variables
        1 + self.variables + low * self.variables - low * low.saturating_sub(1) / 2 + (high - low)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenvectors_reproduce_the_matrix() {
        let n = 7;
        let mut a = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..=i {
                let x = ((i * 31 + j * 17 + 5) % 13) as f64 - 6.0;
                a[i * n + j] = x;
                a[j * n + i] = x;
            }
        }
        let (mut v, mut d, mut e) = (a.clone(), vec![0.0; n], vec![0.0; n]);
        assert!(symmetric_eigen(&mut v, n, &mut d, &mut e));
        assert!(d.windows(2).all(|pair| pair[0] <= pair[1]));
        for i in 0..n {
            for j in 0..n {
                let again: f64 = (0..n).map(|k| v[i * n + k] * d[k] * v[j * n + k]).sum();
                assert!((again - a[i * n + j]).abs() < 1e-12);
            }
        }
        assert!(!symmetric_eigen(&mut [f64::NAN], 1, &mut [0.0], &mut [0.0]));
    }

    #[test]
    fn second_derivatives_stand_where_they_are_looked_for() {
        for variables in 1..5 {
            let monomials = Monomials::new(variables, 3);
            let x: Vec<f64> = (0..variables).map(|a| 2.0 + a as f64).collect();
            let mut values = vec![0.0; monomials.len()];
            monomials.evaluate(&x, &mut values);
            for a in 0..variables {
                assert_eq!(values[1 + a], x[a]);
                for b in 0..variables {
                    assert_eq!(values[monomials.second(a, b)], x[a] * x[b]);
                }
            }
        }
    }

    #[test]
    fn cholesky_solves_and_sees_dependence() {
        let a = [4.0, 2.0, 2.0, 3.0];
        let mut l = a;
        assert!(cholesky(&mut l, 2, 1e-14));
        let mut x = [8.0, 7.0];
        cholesky_solve(&l, 2, &mut x);
        assert!((x[0] - 1.25).abs() < 1e-15 && (x[1] - 1.5).abs() < 1e-15);
        assert!(!cholesky(&mut [1.0, 1.0, 1.0, 1.0], 2, 1e-14));
    }
}
