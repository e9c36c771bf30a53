//! The mean of the completions of an image and of its mirror image.

use serde::Serialize;

/// The amount of work for a completion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Quality {
    /// One fit.
    #[default]
    Standard,
    /// The mean of the completions of an image and of its mirror image, in twice the time and memory.
    Best,
}

impl Quality {
    /// All qualities.
    pub const ALL: [Self; 2] = [Self::Standard, Self::Best];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Standard => "standard",
            Self::Best => "best",
        }
    }
}

/// Returns a map with `width` pixels per row and `channels` values per pixel, with the pixels of every row reversed.
pub(crate) fn mirrored<T: Copy>(values: &[T], width: usize, channels: usize) -> Vec<T> {
    let rows = values.chunks_exact(width * channels);
    let pixels = rows.flat_map(|row| row.chunks_exact(channels).rev());
    pixels.flatten().copied().collect()
}

/// Returns the position in the mirror image of a position (u, v) of an image of `width` columns.
pub(crate) fn mirrored_place([u, v]: [f64; 2], width: usize) -> [f64; 2] {
    let width = width as f64;
    // The left border belongs to the image, the right border does not.
    [(width - 1.0 - u).min((width - 0.5).next_down()), v]
}

/// Replaces every value by the mean of it and the corresponding other value.
pub(crate) fn average<T: Copy>(values: &mut [T], others: &[T], mean: fn(T, T) -> T) {
    let pairs = values.iter_mut().zip(others);
    pairs.for_each(|(value, &other)| *value = mean(*value, other));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_of_every_row_are_reversed_and_their_channels_are_not() {
        let rows = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12];
        let reversed = [5, 6, 3, 4, 1, 2, 11, 12, 9, 10, 7, 8];
        assert_eq!(mirrored(&rows, 3, 2), reversed);
        assert_eq!(mirrored(&reversed, 3, 2), rows);
    }

    #[test]
    fn every_place_of_an_image_has_one_in_its_mirror_image() {
        assert_eq!(mirrored_place([0.0, 7.5], 640), [639.0, 7.5]);
        assert_eq!(mirrored_place([12.25, -0.5], 640), [626.75, -0.5]);
        for u in [
            -0.5,
            (-0.5_f64).next_up(),
            0.1,
            639.499,
            639.5_f64.next_down(),
        ] {
            let [there, _] = mirrored_place([u, 0.0], 640);
            assert!((-0.5..639.5).contains(&there), "{u}: {there}");
            assert!((there - (639.0 - u)).abs() < 1e-12, "{u}: {there}");
        }
    }
}
