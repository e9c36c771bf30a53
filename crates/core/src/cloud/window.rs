//! The points around a pixel of a depth map.

use std::f64::consts::TAU;

/// The offsets of the pixels in an ellipse around a pixel, the nearest first.
pub(super) struct Window(Vec<Offset>);

/// The offset of a pixel from another.
pub(super) struct Offset {
    right: isize,
    down: isize,
    pub(super) distance: f64,
    pub(super) direction: f64,
}

impl Window {
    /// Returns the window with these radii to the right and downwards, in pixels.
    pub(super) fn new(radii: [f64; 2]) -> Self {
        let [across, along] = radii.map(|radius| radius as isize);
        let row = |down: isize| (-across..=across).map(move |right| (right, down));
        let offsets = (-along..=along).flat_map(row).map(|(right, down)| Offset {
            right,
            down,
            distance: (right as f64).hypot(down as f64),
            direction: (down as f64).atan2(right as f64),
        });
        let inside = |offset: &Offset| {
            let share = (offset.right as f64 / radii[0]).hypot(offset.down as f64 / radii[1]);
            offset.distance > 0.0 && share <= 1.0
        };
        let mut offsets: Vec<Offset> = offsets.filter(inside).collect();
        offsets.sort_by(|a, b| a.distance.total_cmp(&b.distance));
        Self(offsets)
    }

    /// Returns the points around a pixel of a map, where depths of 0 are no points.
    pub(super) fn points<'a>(
        &'a self,
        depths: &'a [f32],
        width: usize,
        pixel: usize,
    ) -> impl Iterator<Item = (&'a Offset, f32)> {
        let (x, y) = ((pixel % width) as isize, (pixel / width) as isize);
        self.0.iter().filter_map(move |offset| {
            let (column, row) = (x + offset.right, y + offset.down);
            if !(0..width as isize).contains(&column) || row < 0 {
                return None;
            }
            let depth = *depths.get(row as usize * width + column as usize)?;
            (depth > 0.0).then_some((offset, depth))
        })
    }
}

impl Offset {
    /// Returns the quarter of the directions: right, down, left or up.
    pub(super) fn quarter(&self) -> usize {
        (self.direction / (0.25 * TAU)).round().rem_euclid(4.0) as usize
    }
}
