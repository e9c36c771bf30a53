//! Meeting a deadline: fewer points, then smaller weights.

use std::time::Duration;

/// Quality levels, each faster than the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// All points.
    Full,
    /// At most 2,000 points: a fit of 30,000 takes more than twice as long.
    FewerPoints,
    /// At most 500 points.
    FewPoints,
    /// At most 500 points, and the smaller network.
    SmallWeights,
}

impl Level {
    const ALL: [Self; 4] = [
        Self::Full,
        Self::FewerPoints,
        Self::FewPoints,
        Self::SmallWeights,
    ];

    /// Largest number of points to fit.
    pub fn most_points(self) -> usize {
        match self {
            Self::Full => usize::MAX,
            Self::FewerPoints => 2000,
            Self::FewPoints | Self::SmallWeights => 500,
        }
    }

    /// Name in diagnostics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::FewerPoints => "at most 2000 points",
            Self::FewPoints => "at most 500 points",
            Self::SmallWeights => "at most 500 points, small weights",
        }
    }
}

/// Chooses the level of the next image from the durations of the last ones.
#[derive(Clone, Debug)]
pub(crate) struct Governor {
    most: Option<Duration>,
    lowest: Level,
    level: Level,
    /// Consecutive images fast enough for the level above.
    fast: u32,
    /// Number needed before returning to that level; doubled after each premature return.
    needed: u32,
    /// Images that missed the deadline.
    pub(crate) late: u64,
}

impl Governor {
    /// Fast images needed before the first return.
    const PATIENCE: u32 = 20;
    const MOST_PATIENCE: u32 = 640;

    pub(crate) fn new(most: Option<Duration>, has_small_weights: bool) -> Self {
        Self {
            most,
            lowest: if has_small_weights {
                Level::SmallWeights
            } else {
                Level::FewPoints
            },
            level: Level::Full,
            fast: 0,
            needed: Self::PATIENCE,
            late: 0,
        }
    }

    pub(crate) fn level(&self) -> Level {
        self.level
    }

    /// Adds the duration of an image. Images of another level were started before the level changed.
    pub(crate) fn add(&mut self, level: Level, took: Duration) {
        let Some(most) = self.most else {
            return;
        };
        self.late += u64::from(took > most);
        if level != self.level {
            return;
        }
        let at = Level::ALL.iter().position(|other| *other == level);
        let at = at.unwrap_or_default();
        if took > most {
            if self.level < self.lowest {
                // The return to this level was premature.
                if self.fast == 0 && self.needed > Self::PATIENCE {
                    self.needed = (2 * self.needed).min(Self::MOST_PATIENCE);
                }
                self.level = Level::ALL[at + 1];
            }
            self.fast = 0;
            return;
        }
        // The level above takes up to twice as long.
        self.fast = if 2 * took <= most { self.fast + 1 } else { 0 };
        if at > 0 && self.fast >= self.needed {
            self.level = Level::ALL[at - 1];
            self.fast = 0;
            self.needed = (2 * self.needed).min(Self::MOST_PATIENCE);
        }
    }
}

/// Selects `most` evenly spaced items; `None` if there are no more than that.
pub(crate) fn thinned<T: Copy>(all: &[T], most: usize) -> Option<Vec<T>> {
    (all.len() > most).then(|| (0..most).map(|i| all[i * all.len() / most]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOST: Duration = Duration::from_millis(50);

    fn add(governor: &mut Governor, milliseconds: u64, count: usize) {
        for _ in 0..count {
            governor.add(governor.level(), Duration::from_millis(milliseconds));
        }
    }

    #[test]
    fn quality_is_lowered_step_by_step_and_comes_back_slowly() {
        let mut governor = Governor::new(Some(MOST), true);
        add(&mut governor, 50, 100);
        assert_eq!((governor.level(), governor.late), (Level::Full, 0));
        add(&mut governor, 51, 1);
        assert_eq!(governor.level(), Level::FewerPoints);
        // Images started before the change do not count again.
        governor.add(Level::Full, Duration::from_secs(1));
        assert_eq!((governor.level(), governor.late), (Level::FewerPoints, 2));
        add(&mut governor, 90, 10);
        assert_eq!(governor.level(), Level::SmallWeights);
        // Fast enough, but not for the level above.
        add(&mut governor, 30, 1000);
        assert_eq!(governor.level(), Level::SmallWeights);
        add(&mut governor, 25, 19);
        assert_eq!(governor.level(), Level::SmallWeights);
        add(&mut governor, 25, 1);
        assert_eq!(governor.level(), Level::FewPoints);
        // Premature: the next return takes longer.
        add(&mut governor, 60, 1);
        assert_eq!(governor.level(), Level::SmallWeights);
        add(&mut governor, 20, 79);
        assert_eq!(governor.level(), Level::SmallWeights);
        add(&mut governor, 20, 1);
        assert_eq!(governor.level(), Level::FewPoints);
    }

    #[test]
    fn without_a_deadline_or_small_weights_levels_are_left_out() {
        let mut governor = Governor::new(None, true);
        add(&mut governor, 10_000, 10);
        assert_eq!((governor.level(), governor.late), (Level::Full, 0));
        let mut governor = Governor::new(Some(MOST), false);
        add(&mut governor, 10_000, 10);
        assert_eq!(governor.level(), Level::FewPoints);
    }

    #[test]
    fn points_are_thinned_evenly() {
        let all: Vec<usize> = (0..10).collect();
        assert_eq!(thinned(&all, 10), None);
        assert_eq!(thinned(&all, 4), Some(vec![0, 2, 5, 7]));
    }
}
