//! Evaluation on sequences: errors of the frames, and disagreement between their depths.

use crate::data::{DepthMap, PosedFrame, Sequence};
use crate::metrics::{
    Disagreement, Metric, PredictedErrors, Rules, ScoreAccumulator, Scores, UncertaintyScores,
    ViewDepths,
};
use crate::report::{Column, Row};
use crate::sampling::{Pattern, PoseError};
use lsdc_core::Camera;
use lsdc_files::error::{Error, Result};

/// Frame lags between the two views of each compared pair.
const LAGS: [usize; 2] = [1, 4];

/// A sequence with the inputs given to methods.
#[derive(Clone, Debug)]
pub struct SequenceTask<'a> {
    /// The frames, with true depths and poses.
    frames: &'a [PosedFrame],
    /// Sparse points of each frame.
    pub sparse: Vec<DepthMap>,
    /// Camera of each frame, with the pose given to methods.
    pub cameras: Vec<Camera>,
}

/// Prediction of a method for a frame.
#[derive(Clone, Debug)]
pub struct PredictedFrame {
    /// Depth of every pixel.
    pub depth: DepthMap,
    /// The distribution of its errors, if the method predicts one.
    pub errors: Option<PredictedErrors>,
}

impl<'a> SequenceTask<'a> {
    /// Draws the points of all frames and the errors of their poses; a seed gives the same result on every machine.
    ///
    /// # Errors
    /// The errors of [`Pattern::draw`].
    pub fn draw(
        sequence: &'a Sequence,
        points: &Pattern,
        poses: PoseError,
        seed: u64,
    ) -> Result<Self> {
        let frames = sequence.frames();
        let sparse: Result<_> = frames
            .iter()
            .map(|posed| points.draw(&posed.frame, seed))
            .collect();
        let cameras: Vec<Camera> = frames.iter().map(|posed| posed.camera.clone()).collect();
        Ok(Self {
            frames,
            sparse: sparse?,
            cameras: poses.apply(&cameras, seed),
        })
    }

    /// Returns the number of frames.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Returns whether there are no frames.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Completes all frames in order, calling the method with the index of each frame, and measures the depths: their errors
    /// against the truth, and the disagreement of each frame with those one and four frames later, by the true poses.
    ///
    /// ```
    /// # fn main() -> lsdc_files::error::Result<()> {
    /// use lsdc_eval::data::RoomPath;
    /// use lsdc_eval::evaluation::{PredictedFrame, SequenceTask};
    /// use lsdc_eval::metrics::Rules;
    /// use lsdc_eval::predict::{Classic, complete_classic};
    /// use lsdc_eval::sampling::{Pattern, PoseError};
    /// let path = RoomPath { frames: 3, width: 64, height: 48, ..RoomPath::default() };
    /// let room = path.render()?;
    /// let task = SequenceTask::draw(&room, &Pattern::Exactly(200), PoseError::Exact, 0)?;
    /// let scores = task.measure(&Rules::default(), |index| {
    ///     let rgb = &room.frames()[index].frame.rgb;
    ///     let depth = complete_classic(Classic::Linear, rgb, &task.sparse[index])?;
    ///     Ok(PredictedFrame { depth, errors: None })
    /// })?;
    /// let median = scores.disagreement().quantile(0.5).expect("frames overlap");
    /// assert!(median < 0.02, "{median}");
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// Errors of the method, with the name of the frame; or a depth map whose size differs from its frame.
    pub fn measure(
        &self,
        rules: &Rules,
        mut complete: impl FnMut(usize) -> Result<PredictedFrame>,
    ) -> Result<SequenceScores> {
        let mut found = SequenceScores::default();
        let mut depths: Vec<DepthMap> = Vec::with_capacity(self.len());
        for (index, posed) in self.frames.iter().enumerate() {
            let PosedFrame { frame, .. } = posed;
            let PredictedFrame { depth, errors } = complete(index).map_err(|error| {
                Error::config(format!("frame `{}` was not completed", frame.id)).because(error)
            })?;
            let scores = Scores::of(&depth, &frame.depth, rules)?;
            found.scores.add(&scores);
            if let Some(errors) = errors {
                let uncertainty = UncertaintyScores::of(&depth, &frame.depth, &errors);
                found.uncertainty.get_or_insert_default().add(&uncertainty);
            }
            depths.push(depth);
            for earlier in LAGS.iter().filter_map(|lag| index.checked_sub(*lag)) {
                let [from, to] = [earlier, index].map(|i| ViewDepths {
                    camera: &self.frames[i].camera,
                    predicted: &depths[i],
                    truth: &self.frames[i].frame.depth,
                });
                found.disagreement.add(&Disagreement::of(&from, &to)?);
            }
        }
        Ok(found)
    }
}

/// Metrics of a method on sequences.
#[derive(Clone, Debug, Default)]
pub struct SequenceScores {
    scores: ScoreAccumulator,
    disagreement: Disagreement,
    uncertainty: Option<UncertaintyScores>,
}

impl SequenceScores {
    /// Adds the results of another sequence.
    pub fn add(&mut self, other: &Self) {
        self.scores.merge(&other.scores);
        self.disagreement.add(&other.disagreement);
        if let Some(uncertainty) = &other.uncertainty {
            self.uncertainty.get_or_insert_default().add(uncertainty);
        }
    }

    /// Returns the disagreement between frames.
    pub fn disagreement(&self) -> &Disagreement {
        &self.disagreement
    }

    /// Returns the columns of a table: RMSE, REL (%), median and 90 % quantile of the disagreement (%), the share of pixels
    /// seen in both frames but not compared (%), and the shares of errors within the intervals of 68.3 and 95.4 % (%).
    pub fn columns() -> Vec<Column> {
        let share = |label: &str, decimals| Column {
            label: label.to_owned(),
            unit: "%",
            decimals,
            higher_is_better: false,
        };
        vec![
            Column::of(Metric::Rmse),
            share("REL", 2),
            share("dis. median", 3),
            share("dis. 90 %", 2),
            share("unmatched", 2),
            share("in 68.3 %", 1),
            share("in 95.4 %", 1),
        ]
    }

    /// Returns a row of the table.
    pub fn row(&self, label: &str) -> Row {
        let mean = self.scores.mean();
        let percent = |value: Option<f64>| value.map(|value| 100.0 * value);
        let coverage = self.uncertainty.as_ref().map(UncertaintyScores::coverage);
        let unmatched = self.disagreement.unmatched() as f64;
        let seen = unmatched + self.disagreement.compared() as f64;
        Row {
            label: label.to_owned(),
            unranked: false,
            values: vec![
                mean.map(|scores| scores[Metric::Rmse]),
                percent(mean.map(|scores| scores[Metric::Rel])),
                percent(self.disagreement.quantile(0.5)),
                percent(self.disagreement.quantile(0.9)),
                percent((seen > 0.0).then(|| unmatched / seen)),
                percent(coverage.map(|(one, _)| one)),
                percent(coverage.map(|(_, two)| two)),
            ],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::RoomPath;

    fn room(still: bool) -> Sequence {
        let path = RoomPath {
            frames: 6,
            width: 64,
            height: 48,
            still,
            ..RoomPath::default()
        };
        path.render().unwrap()
    }

    /// Measures the truth times a factor for each frame, with a standard deviation of 5 % of the depth.
    fn measured(sequence: &Sequence, factor: impl Fn(usize) -> f32) -> SequenceScores {
        let task = SequenceTask::draw(sequence, &Pattern::Exactly(50), PoseError::Shuffled, 0);
        let task = task.unwrap();
        assert!(task.sparse.iter().all(|map| map.count() == 50));
        let scaled = |map: &DepthMap, factor: f32| {
            let values = map.values().iter().map(|depth| depth * factor).collect();
            DepthMap::new(map.width(), map.height(), values).unwrap()
        };
        let complete = |index: usize| {
            let truth = &sequence.frames()[index].frame.depth;
            Ok(PredictedFrame {
                depth: scaled(truth, factor(index)),
                errors: Some(PredictedErrors {
                    deviations: scaled(truth, 0.05),
                    freedom: None,
                }),
            })
        };
        task.measure(&Rules::default(), complete).unwrap()
    }

    #[test]
    fn the_truth_agrees_with_itself_by_the_true_poses() {
        let mut scores = measured(&room(false), |_| 1.0);
        let row = scores.row("truth");
        assert_eq!(row.values.len(), SequenceScores::columns().len());
        assert_eq!(row.values[0], Some(0.0));
        // The truth itself, interpolated: within the bound for pixels seen in both views.
        assert!(row.values[2].unwrap() < 0.1 && row.values[3].unwrap() < 1.0);
        assert_eq!(row.values[5..], [Some(100.0); 2]);
        let compared = scores.disagreement().compared();
        // 5 pairs at lag 1 and 2 at lag 4, which overlap.
        assert!(
            compared > 64 * 48 * 7 / 2 && compared <= 64 * 48 * 7,
            "{compared}"
        );
        scores.add(&scores.clone());
        assert_eq!(scores.disagreement().compared(), 2 * compared);
    }

    /// Every second frame is 10 % too far; frames at lag 1 differ by 10 % of either depth, frames at lag 4 agree.
    #[test]
    fn disagreement_of_a_still_camera_is_its_flicker() {
        let scores = measured(&room(true), |index| if index % 2 == 1 { 1.1 } else { 1.0 });
        let found = scores.disagreement();
        assert_eq!(found.compared(), 7 * 64 * 48);
        for (share, expected) in [(0.28, 0.0), (0.3, 0.1 / 1.1), (0.7, 0.1 / 1.1), (0.72, 0.1)] {
            let value = found.quantile(share).unwrap();
            assert!((value - expected).abs() < 1e-6, "{share}: {value}");
        }
        // Half of the frames are exact, and 10 % is two standard deviations: 1.9999 is less.
        let values = scores.row("flicker").values;
        assert!((values[5].unwrap() - 50.0).abs() < 1e-9, "{values:?}");
        assert!((values[1].unwrap() - 5.0).abs() < 1e-3, "{values:?}");
    }
}
