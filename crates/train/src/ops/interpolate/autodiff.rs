//! The backward pass: one more op of the inner backend.

use super::{Cells, InterpolateBackend};
use burn::backend::autodiff::Autodiff;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{AutodiffBackend as _, TensorMetadata as _};

#[derive(Debug)]
struct InterpolateBackward;

impl<B: InterpolateBackend> Backward<B, 1> for InterpolateBackward {
    type State = ([usize; 3], Cells);

    fn backward(
        self,
        ops: Ops<Self::State, 1>,
        grads: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let [table] = ops.parents;
        let grad = grads.consume::<B>(&ops.node);
        let (shape, cells) = ops.state;
        if let Some(node) = table {
            let value = B::read_between_backward(grad, shape, cells);
            grads.register::<B>(node.id, value);
        }
    }
}

impl<B: InterpolateBackend, C: CheckpointStrategy> InterpolateBackend for Autodiff<B, C> {
    fn read_between(table: FloatTensor<Self>, cells: Cells) -> FloatTensor<Self> {
        let shape = table.shape();
        let shape = [shape[0], shape[1], shape[2]];
        let prepared = InterpolateBackward
            .prepare::<C>([table.node()])
            .compute_bound()
            .stateful();
        let output = B::read_between(table.into_primitive(), cells.clone());
        match prepared {
            OpsKind::Tracked(prep) => prep.finish((shape, cells), output),
            OpsKind::UnTracked(prep) => prep.finish(output),
        }
    }

    fn read_between_backward(
        grad: FloatTensor<Self>,
        shape: [usize; 3],
        cells: Cells,
    ) -> FloatTensor<Self> {
        Self::from_inner(B::read_between_backward(
            grad.into_primitive(),
            shape,
            cells,
        ))
    }
}
