//! Completion tasks: the given points of a frame, and the depths to score.

use super::{HoldOut, Noise, Pattern};
use crate::data::{DepthMap, Frame};
use lsdc_files::error::{Error, Result};

/// The points of a frame and the depths to predict, as large as the frame.
#[derive(Clone, Debug, PartialEq)]
pub struct CompletionTask {
    /// Sparse depths given to methods.
    pub sparse: DepthMap,
    /// True depths to score.
    pub truth: DepthMap,
}

impl CompletionTask {
    /// Draws the points of a frame that the protocol was applied to; a seed gives the same points on every machine.
    ///
    /// Held-out pixels are scored and never given. If none are held out, all true depths are scored, including given ones; for
    /// laser scans, whose points are drawn from all returns, given points are not scored.
    ///
    /// # Errors
    /// The errors of [`Pattern::draw`] and [`HoldOut::mask`], or no depth is left to score.
    pub fn draw(
        frame: &Frame,
        points: &Pattern,
        hold_out: Option<HoldOut>,
        noise: Option<Noise>,
        seed: u64,
    ) -> Result<Self> {
        let held_out = hold_out.map(|law| law.mask(frame, seed)).transpose()?;
        let returns = frame.sparse.as_ref().filter(|_| frame.rings.is_some());
        let drawn = match (&held_out, returns) {
            (None, None) => points.draw(frame, seed)?,
            (held_out, returns) => {
                let remaining = |map: &DepthMap| match held_out {
                    None => Ok(map.clone()),
                    Some(held_out) => masked(map, |pixel| !held_out[pixel]),
                };
                let sparse = frame.sparse.as_ref().map(remaining).transpose()?;
                let candidates = Frame {
                    depth: remaining(returns.unwrap_or(&frame.depth))?,
                    sparse,
                    ..frame.clone()
                };
                // Repeated, because points may come from files.
                remaining(&points.draw(&candidates, seed)?)?
            }
        };
        let truth = match (&held_out, returns) {
            (None, None) => frame.depth.clone(),
            (Some(held_out), _) => masked(&frame.depth, |pixel| held_out[pixel])?,
            (None, Some(_)) => masked(&frame.depth, |pixel| drawn.values()[pixel] == 0.0)?,
        };
        if truth.count() == 0 {
            return Err(Error::config(format!(
                "frame `{}` has no true depth that is not given",
                frame.id
            ))
            .hint("hold returns out, as with --hold-out ring:4, or give fewer: --points 500"));
        }
        let sparse = match noise {
            None => drawn,
            Some(noise) => noise.apply(&drawn, seed, &frame.id)?,
        };
        Ok(Self { sparse, truth })
    }
}

/// Returns the map with only the depths at selected pixels.
fn masked(map: &DepthMap, counts: impl Fn(usize) -> bool) -> Result<DepthMap> {
    let values = map.values().iter().enumerate();
    let values = values.map(|(pixel, depth)| if counts(pixel) { *depth } else { 0.0 });
    Ok(DepthMap::new(map.width(), map.height(), values.collect())?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::ProtocolPreset;
    use image::RgbImage;

    /// Ten returns in a row on rings 0 to 9; the last but one is behind the last.
    fn scan() -> Frame {
        let mut values: Vec<f32> = (0..10).map(|i| 5.0 + 0.1 * i as f32).collect();
        values[8] = 20.0;
        let depth = DepthMap::new(10, 1, values).unwrap();
        let frame = Frame::new("a".into(), RgbImage::new(10, 1), depth.clone()).unwrap();
        let frame = frame.with_sparse(depth).unwrap();
        frame.with_rings((0..10).collect()).unwrap()
    }

    fn task(frame: &Frame, points: &str, hold_out: Option<&str>) -> Result<CompletionTask> {
        let law = hold_out.map(|law| law.parse().unwrap());
        CompletionTask::draw(frame, &points.parse().unwrap(), law, None, 0)
    }

    fn columns(map: &DepthMap) -> Vec<usize> {
        map.points().map(|p| p.x).collect()
    }

    #[test]
    fn rings_are_given_or_scored_after_the_filter_of_the_protocol() {
        let of = |preset: &str| {
            let frame = ProtocolPreset::named(preset)
                .unwrap()
                .protocol
                .apply(&scan());
            let task = task(&frame.unwrap(), "given", Some("ring:4")).unwrap();
            (columns(&task.sparse), columns(&task.truth))
        };
        // A scanner's points include the return behind a surface, which is never scored.
        assert_eq!(of("scans"), (vec![0, 4, 8], vec![1, 2, 3, 5, 6, 7, 9]));
        assert_eq!(
            of("scans-filtered"),
            (vec![0, 4], vec![1, 2, 3, 5, 6, 7, 9])
        );
    }

    #[test]
    fn returns_that_are_not_given_are_scored() {
        let frame = ProtocolPreset::named("scans")
            .unwrap()
            .protocol
            .apply(&scan())
            .unwrap();
        let task_of = |points| task(&frame, points, None);
        let found = task_of("4").unwrap();
        assert_eq!(found.sparse.count(), 4);
        let mut all = [columns(&found.sparse), columns(&found.truth)].concat();
        all.sort_unstable();
        all.retain(|x| *x != 8);
        assert_eq!(all, [0, 1, 2, 3, 4, 5, 6, 7, 9]);
        assert!(task_of("given").is_err());
    }

    #[test]
    fn other_frames_are_scored_everywhere_unless_something_is_held_out() {
        let depth = DepthMap::new(32, 24, (1..=768).map(|v| v as f32).collect()).unwrap();
        let frame = Frame::new("a".into(), RgbImage::new(32, 24), depth).unwrap();
        let whole = task(&frame, "50", None).unwrap();
        assert_eq!(whole.truth, frame.depth);
        assert_eq!(whole.sparse, Pattern::Exactly(50).draw(&frame, 0).unwrap());
        for law in ["clusters:5", "region"] {
            let part = task(&frame, "50", Some(law)).unwrap();
            assert_eq!(part.sparse.count(), 50, "{law}");
            let twice = part
                .truth
                .points()
                .filter(|p| part.sparse.at(p.x, p.y) > 0.0);
            assert_eq!(twice.count(), 0, "{law}");
            assert!(part.truth.count() < 768 / 2, "{law}");
        }
        assert!(task(&frame, "50", Some("ring:2")).is_err());
    }
}
