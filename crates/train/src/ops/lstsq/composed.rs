//! The differentiable steps around a factorisation on a device, from burn's own operations.

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, TensorMetadata as _};
use burn::tensor::{Shape, TensorData};
use lsdc_core::fit::Solver;

/// Returns `[sqrt(w) F | sqrt(w) d]`, `[batch, n, k + 1]`; with a ridge, `sqrt(mu) I` is appended below, so that R is that of
/// the regularised problem without forming the normal equations.
pub(super) fn rows<B: Backend>(
    bases: FloatTensor<B>,
    depths: FloatTensor<B>,
    weights: FloatTensor<B>,
    solver: Solver,
) -> FloatTensor<B> {
    let k = bases.shape()[2];
    let scaled = Scaled::<B>::new(bases, depths, weights, solver);
    let rows = B::float_cat(vec![scaled.bases.clone(), scaled.depths], 2);
    let Some(shift) = scaled.shift else {
        return rows;
    };
    let device = rows.device();
    let identity: Vec<f32> = (0..k * (k + 1))
        .map(|i| f32::from(u8::from(i / (k + 1) == i % (k + 1))))
        .collect();
    let identity = B::float_from_data(TensorData::new(identity, vec![1, k, k + 1]), &device);
    let below = B::float_mul(identity, B::float_sqrt(shift));
    B::float_cat(vec![rows, below], 1)
}

/// A problem with rows scaled by the square roots of their weights.
struct Scaled<B: Backend> {
    roots: FloatTensor<B>,
    bases: FloatTensor<B>,
    depths: FloatTensor<B>,
    /// Ridge mu `[batch, 1, 1]`, if there is one.
    shift: Option<FloatTensor<B>>,
}

impl<B: Backend> Scaled<B> {
    fn new(
        bases: FloatTensor<B>,
        depths: FloatTensor<B>,
        weights: FloatTensor<B>,
        solver: Solver,
    ) -> Self {
        let shape = bases.shape();
        let (batch, n, k) = (shape[0], shape[1], shape[2]);
        let column = |t: FloatTensor<B>| B::float_reshape(t, Shape::from([batch, n, 1]));
        let roots = column(B::float_sqrt(weights));
        let bases = B::float_mul(bases, roots.clone());
        let depths = B::float_mul(column(depths), roots.clone());
        let shift = match solver {
            Solver::Truncated(_) => None,
            Solver::Ridge(share) => {
                let squares = B::float_mul(bases.clone(), bases.clone());
                let squares = B::float_reshape(squares, Shape::from([batch, n * k]));
                let trace =
                    B::float_reshape(B::float_sum_dim(squares, 1), Shape::from([batch, 1, 1]));
                Some(B::float_mul_scalar(trace, (share / k as f64).into()))
            }
        };
        Self {
            roots,
            bases,
            depths,
            shift,
        }
    }
}

/// Computes the gradients of `bases` and `depths` from the solution x and the factor K. Let r = d - F x, v = (F^T F + mu)^+ g,
/// q = (F^+)^T g, u = (F^+)^T x, and P the projection on the discarded directions. Then grad d = q and grad F = r v^T - q x^T +
/// u (P g)^T - 2 mu / trace (v . x) F (Golub and Pereyra 1973; the last term is that of a ridge proportional to the trace).
/// Discarded directions are treated as exactly zero.
///
/// q, u and v are refined once, because products with K K^T alone lose digits for large condition numbers.
pub(super) fn backward<B: Backend>(
    bases: FloatTensor<B>,
    depths: FloatTensor<B>,
    weights: FloatTensor<B>,
    (solution, factor): (FloatTensor<B>, FloatTensor<B>),
    grad: FloatTensor<B>,
    solver: Solver,
) -> [FloatTensor<B>; 2] {
    let shape = bases.shape();
    let (batch, n, k) = (shape[0], shape[1], shape[2]);
    let Scaled {
        roots,
        bases,
        depths,
        shift,
    } = Scaled::<B>::new(bases, depths, weights, solver);
    let product = |a: &FloatTensor<B>, b: &FloatTensor<B>| B::float_matmul(a.clone(), b.clone());
    let transposed = |a: &FloatTensor<B>| B::float_swap_dims(a.clone(), 1, 2);
    let column = |t: FloatTensor<B>| B::float_reshape(t, Shape::from([batch, k, 1]));
    let (x, g) = (column(solution), column(grad));
    let (rows, columns) = (transposed(&bases), transposed(&factor));
    let inverse = |v: &FloatTensor<B>| product(&factor, &product(&columns, v));

    // Solves (F^T F + mu) v = b, with refinement.
    let refined = |b: &FloatTensor<B>| {
        let first = inverse(b);
        let mut met = product(&rows, &product(&bases, &first));
        if let Some(shift) = &shift {
            met = B::float_add(met, B::float_mul(first.clone(), shift.clone()));
        }
        B::float_add(first, inverse(&B::float_sub(b.clone(), met)))
    };
    let residual = B::float_sub(depths, product(&bases, &x));
    let (v, extra) = match solver {
        Solver::Ridge(share) => {
            let v = refined(&g);
            let along = product(&transposed(&v), &x);
            let shrink = B::float_mul_scalar(along, (-2.0 * share / k as f64).into());
            (v, B::float_mul(bases.clone(), shrink))
        }
        Solver::Truncated(_) => {
            let retained = projected::<B>(&factor, &g);
            let v = refined(&retained);
            let u = product(&bases, &refined(&x));
            let left = B::float_sub(g.clone(), retained);
            (v, product(&u, &transposed(&left)))
        }
    };
    let q = product(&bases, &v);
    let bases = B::float_add(
        B::float_sub(
            product(&residual, &transposed(&v)),
            product(&q, &transposed(&x)),
        ),
        extra,
    );
    [
        B::float_mul(bases, roots.clone()),
        B::float_reshape(B::float_mul(q, roots), Shape::from([batch, n])),
    ]
}

/// Returns the projection of `g [batch, k, 1]` on the kept directions: those of the columns of K, which are orthogonal if any
/// direction was discarded. If none was, the result is `g`.
fn projected<B: Backend>(factor: &FloatTensor<B>, g: &FloatTensor<B>) -> FloatTensor<B> {
    let k = factor.shape()[2] as f64;
    let squares = B::float_sum_dim(B::float_mul(factor.clone(), factor.clone()), 1);
    // 1 for kept columns, 0 for others.
    let retained = B::float_sign(squares.clone());
    let left = B::float_add_scalar(B::float_neg(retained.clone()), 1.0.into());
    let norms = B::float_sqrt(B::float_add(squares, left));
    let directions = B::float_div(factor.clone(), norms);
    let along = B::float_matmul(B::float_swap_dims(directions.clone(), 1, 2), g.clone());
    let within = B::float_matmul(directions, along);
    // 1 if all directions were kept, otherwise 0.
    let all = B::float_add_scalar(B::float_sum_dim(retained, 2), (1.0 - k).into());
    let all = B::float_clamp_min(all, 0.0.into());
    B::float_add(
        within.clone(),
        B::float_mul(B::float_sub(g.clone(), within), all),
    )
}
