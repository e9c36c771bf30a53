//! What was fused and what was left out.

/// What was fused and what was left out.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Report {
    /// Frames that were added.
    pub frames: usize,
    /// Pixels that were fused.
    pub pixels: usize,
    /// Pixels that were not.
    pub left_out: LeftOut,
    /// The edge length of a voxel; 0 before the first frame.
    pub voxel: f64,
    /// Blocks of 8x8x8 voxels.
    pub blocks: usize,
    /// Bytes that they take.
    pub memory: usize,
}

impl Report {
    pub(crate) fn add(&mut self, used: usize, left_out: LeftOut) {
        self.frames += 1;
        self.pixels += used;
        self.left_out.add(left_out);
    }
}

/// Numbers of pixels that were left out. A pixel counts once, for the first of these reasons.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct LeftOut {
    /// Without a measurement.
    pub unmeasured: usize,
    /// Beyond the largest depth, such as sky, or beyond the range of the voxels' indices.
    pub far: usize,
    /// Outside the valid field of view of the lens.
    pub outside_lens: usize,
    /// With a standard deviation that is not positive and finite, or a too large part of the depth.
    pub uncertain: usize,
    /// Between the surfaces on both sides of a depth edge.
    pub flying: usize,
    /// Without neighbours of their row or column, so that the surface has no normal.
    pub isolated: usize,
    /// At a too large angle to the surface's normal.
    pub grazing: usize,
}

impl LeftOut {
    /// All of them.
    pub fn total(&self) -> usize {
        self.reasons().iter().map(|(_, count)| count).sum()
    }

    /// The numbers, each with its reason.
    pub fn reasons(&self) -> [(&'static str, usize); 7] {
        [
            ("without depth", self.unmeasured),
            ("too far", self.far),
            ("outside the lens", self.outside_lens),
            ("too uncertain", self.uncertain),
            ("flying", self.flying),
            ("isolated", self.isolated),
            ("at grazing angles", self.grazing),
        ]
    }

    pub(crate) fn add(&mut self, other: Self) {
        self.unmeasured += other.unmeasured;
        self.far += other.far;
        self.outside_lens += other.outside_lens;
        self.uncertain += other.uncertain;
        self.flying += other.flying;
        self.isolated += other.isolated;
        self.grazing += other.grazing;
    }
}
