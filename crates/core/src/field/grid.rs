//! The pixel grid of a field.

/// The affinities of neighbouring pixels, `[height * width]` each, none negative.
#[derive(Clone, Copy, Debug)]
pub struct Grid<'a> {
    /// Number of rows.
    pub height: usize,
    /// Number of columns.
    pub width: usize,
    /// Affinity of each pixel with its right neighbour; the last column is not used.
    pub right: &'a [f64],
    /// Affinity of each pixel with the one below; the last row is not used.
    pub down: &'a [f64],
    /// Regularisation of the diagonal, which draws each pixel towards 0; 0 = none.
    pub diagonal_regularisation: f64,
}

impl Grid<'_> {
    pub(super) fn check(&self) {
        let pixels = self.height * self.width;
        assert_eq!([self.right.len(), self.down.len()], [pixels; 2], "grid");
    }
}
