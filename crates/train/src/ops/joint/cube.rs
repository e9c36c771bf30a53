//! The operation on GPUs: the values of all problems come to the host in one transfer.

use super::host::{Shapes, solve};
use super::{JointBackend, JointGradients, Problems};
use crate::ops::gpu::read_together;
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;

type Floats = FloatTensor<CubeBackend>;

impl JointBackend for CubeBackend {
    fn joint(
        bases: Floats,
        depths: Floats,
        draws: Floats,
        affinities: Floats,
        problems: Problems,
    ) -> Floats {
        let of = Shapes::<Self>::of(&bases, &affinities);
        let values = read_together([bases, depths, draws, affinities]);
        solve::<Self>(values, of, &problems)
    }
}

impl JointGradients for CubeBackend {}
