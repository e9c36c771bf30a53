//! Measurements in a time series, found by their times.

use crate::message::Timestamp;

/// Measurements sorted by time.
#[derive(Clone, Debug)]
pub(crate) struct TimeSeries<T>(Vec<(Timestamp, T)>);

impl<T> Default for TimeSeries<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T> TimeSeries<T> {
    /// Sorts measurements; of several at the same time the first stays first.
    pub(crate) fn new(mut found: Vec<(Timestamp, T)>) -> Self {
        found.sort_by_key(|(stamp, _)| *stamp);
        Self(found)
    }

    /// Adds a measurement; of several at the same time the first stays first.
    pub(crate) fn insert(&mut self, stamp: Timestamp, found: T) {
        let after = self.0.partition_point(|(time, _)| *time <= stamp);
        self.0.insert(after, (stamp, found));
    }

    /// Drops the earliest measurements, so that at most `most` are left.
    pub(crate) fn keep_last(&mut self, most: usize) {
        let forgotten = self.0.len().saturating_sub(most);
        self.0.drain(..forgotten);
    }

    /// Drops the measurements before a time.
    pub(crate) fn forget_before(&mut self, stamp: Timestamp) {
        let kept = self.0.partition_point(|(time, _)| *time < stamp);
        self.0.drain(..kept);
    }

    pub(crate) fn iter(&self) -> impl DoubleEndedIterator<Item = &(Timestamp, T)> {
        self.0.iter()
    }

    pub(crate) fn last(&self) -> Option<&(Timestamp, T)> {
        self.0.last()
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the measurement nearest to a time; of two at the same distance the earlier.
    pub(crate) fn nearest(&self, stamp: Timestamp) -> Option<&(Timestamp, T)> {
        let after = self.0.partition_point(|(time, _)| *time < stamp);
        let around = [after.checked_sub(1), Some(after)];
        let around = around.into_iter().flatten().filter_map(|i| self.0.get(i));
        around.min_by_key(|(time, _)| time.abs_diff(stamp))
    }

    /// Returns the measurement valid at a time: the last one at or before it, or else the first.
    pub(crate) fn valid(&self, stamp: Timestamp) -> Option<&T> {
        let after = self.0.partition_point(|(time, _)| *time <= stamp);
        self.0.get(after.saturating_sub(1)).map(|(_, found)| found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_and_the_valid() {
        let series = TimeSeries::new(vec![(30, 'c'), (10, 'a'), (20, 'b')]);
        let nearest = |stamp| series.nearest(stamp).unwrap().1;
        let found = [0, 10, 14, 15, 16, 26, 99].map(nearest);
        assert_eq!(found, ['a', 'a', 'a', 'a', 'b', 'c', 'c']);
        let found = [0, 10, 19, 20, 99].map(|stamp| *series.valid(stamp).unwrap());
        assert_eq!(found, ['a', 'a', 'a', 'b', 'c']);
        let mut one_by_one = TimeSeries::default();
        for (stamp, name) in [(20, 'b'), (30, 'c'), (10, 'a'), (20, 'z')] {
            one_by_one.insert(stamp, name);
        }
        let at = |stamp| one_by_one.nearest(stamp).unwrap().1;
        assert_eq!([0, 14, 20, 21, 99].map(at), ['a', 'a', 'b', 'z', 'c']);
        one_by_one.forget_before(20);
        assert_eq!(one_by_one.nearest(0), Some(&(20, 'b')));
        one_by_one.keep_last(1);
        assert_eq!(one_by_one.nearest(0), one_by_one.last());
        assert_eq!(one_by_one.last(), Some(&(30, 'c')));
        assert!(TimeSeries::<u8>::new(Vec::new()).nearest(5).is_none());
        assert!(TimeSeries::<u8>::new(Vec::new()).valid(5).is_none());
    }
}
