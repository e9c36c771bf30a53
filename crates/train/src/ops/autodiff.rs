//! Custom operations on burn's tape, with gradients that are operations too.

use burn::backend::Backend;
use burn::backend::autodiff::Autodiff;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, NodeGuard, Ops};
use burn::backend::tensor::FloatTensor;
use std::fmt::{Debug, Formatter};

/// Records the output of an operation on the tape of its `N` differentiable inputs.
///
/// `backward` captures what it needs of the forward pass. From the gradient of the output and the flags of which inputs need
/// gradients, it computes the gradients of the inputs; gradients that are not needed may be `None`.
pub(super) fn record<B: Backend, C: CheckpointStrategy, const N: usize>(
    inputs: [NodeGuard; N],
    output: FloatTensor<B>,
    backward: impl FnOnce(FloatTensor<B>, [bool; N]) -> [Option<FloatTensor<B>>; N] + Send + 'static,
) -> FloatTensor<Autodiff<B, C>> {
    Backward::<B, N>::prepare::<C>(Recorded(backward), inputs)
        .compute_bound()
        .stateless(output)
}

/// A backward pass. Burn suggests a type without fields and a cloneable state; this one runs once and needs neither.
struct Recorded<F>(F);

impl<F> Debug for Recorded<F> {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.write_str("Recorded")
    }
}

impl<B, F, const N: usize> Backward<B, N> for Recorded<F>
where
    B: Backend,
    F: FnOnce(FloatTensor<B>, [bool; N]) -> [Option<FloatTensor<B>>; N] + Send + 'static,
{
    type State = ();

    fn backward(self, ops: Ops<(), N>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let needed = ops.parents.each_ref().map(Option::is_some);
        let found = (self.0)(grad, needed);
        for (parent, gradient) in ops.parents.into_iter().zip(found) {
            if let (Some(node), Some(gradient)) = (parent, gradient) {
                grads.register::<B>(node.id, gradient);
            }
        }
    }
}
