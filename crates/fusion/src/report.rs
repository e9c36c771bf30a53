//! Statistics of a fusion.

/// Statistics of fused and skipped data.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Report {
    /// Number of fused frames.
    pub frames: usize,
    /// Number of fused pixels.
    pub pixels: usize,
    /// Number of skipped pixels.
    pub left_out: LeftOut,
    /// The edge length of a voxel; 0 before the first frame.
    pub voxel: f64,
    /// Number of blocks of 8x8x8 voxels.
    pub blocks: usize,
    /// Size of the blocks in bytes.
    pub memory: usize,
}

impl Report {
    pub(crate) fn add(&mut self, used: usize, left_out: LeftOut) {
        self.frames += 1;
        self.pixels += used;
        self.left_out.add(left_out);
    }
}

/// Numbers of skipped pixels by reason. A pixel counts once, for the first of these reasons that applies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct LeftOut {
    /// Pixels without a measurement.
    pub unmeasured: usize,
    /// Pixels beyond the largest depth, such as sky, or beyond the range of voxel indices.
    pub far: usize,
    /// Pixels outside the valid field of view of the lens.
    pub outside_lens: usize,
    /// Pixels with a standard deviation that is not positive and finite, or too large relative to the depth.
    pub uncertain: usize,
    /// Flying pixels, between the surfaces on both sides of a depth edge.
    pub flying: usize,
    /// Pixels without neighbours in their row or column, so that the surface has no normal.
    pub isolated: usize,
    /// Pixels with a too large angle between ray and normal.
    pub grazing: usize,
}

impl LeftOut {
    /// The total number.
    pub fn total(&self) -> usize {
        self.reasons().iter().map(|(_, count)| count).sum()
    }

    /// The numbers with the names of their reasons.
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
