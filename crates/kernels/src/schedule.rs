//! Traces of parallel computations, recorded on one thread to predict the run time on many threads.
//!
//! Threads share the work of a [`region`], which consists of [tasks](Region::task); [`InTasks`] makes regions of tasks from
//! parallel iterators. Unless [`record`] is running, regions and tasks only read a thread-local variable.
//!
//! ```
//! use lsdc_kernels::schedule::{InTasks, Segment, record};
//! use rayon::prelude::*;
//!
//! let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
//! let squares = || [1, 2].par_iter().gather::<Vec<i32>, _>(|number| number * number);
//! let (squares, trace) = pool.install(|| record(2, squares));
//! assert_eq!(squares, [1, 4]);
//! assert!(matches!(&trace.0[..], [_, Segment::Parallel(tasks), _] if tasks.len() == 2));
//! # Ok::<(), rayon::ThreadPoolBuildError>(())
//! ```

use crate::clock::Instant;
use rayon::prelude::*;
use std::cell::{Cell, RefCell};
use std::time::Duration;

/// The segments of a task, in order.
#[derive(Clone, Debug, Default)]
pub struct TaskTrace(pub Vec<Segment>);

/// A segment of a task.
#[derive(Clone, Debug)]
pub enum Segment {
    /// Serial work, with its run time.
    Serial(Duration),
    /// Tasks shared by threads; the next segment begins when all have ended.
    Parallel(Vec<TaskTrace>),
}

/// A running task, the start of its last segment, and the finished tasks of its region.
struct RunningTask {
    trace: TaskTrace,
    since: Instant,
    ended: Vec<TaskTrace>,
}

thread_local! {
    /// The running tasks, the outermost first; empty if nothing is recorded.
    static RUNNING: RefCell<Vec<RunningTask>> = const { RefCell::new(Vec::new()) };
    /// The number of threads for which work is divided while it is recorded.
    static THREADS: Cell<usize> = const { Cell::new(1) };
}

impl RunningTask {
    fn new() -> Self {
        Self {
            trace: TaskTrace::default(),
            since: Instant::now(),
            ended: Vec::new(),
        }
    }

    fn end_segment(&mut self) {
        self.trace.0.push(Segment::Serial(self.since.elapsed()));
    }

    fn end(mut self) -> TaskTrace {
        self.end_segment();
        self.trace
    }
}

/// Runs `work`, divided for this many threads, and returns its trace. It should run in a pool of one thread.
pub fn record<R>(threads: usize, work: impl FnOnce() -> R) -> (R, TaskTrace) {
    THREADS.set(threads);
    let outer = RUNNING.replace(vec![RunningTask::new()]);
    let result = work();
    let task = RUNNING.replace(outer).pop();
    (result, task.map(RunningTask::end).unwrap_or_default())
}

/// The number of threads for which work is divided: those of the pool, unless it is recorded.
pub fn threads() -> usize {
    if RUNNING.with_borrow(Vec::is_empty) {
        rayon::current_num_threads()
    } else {
        THREADS.get()
    }
}

/// Work shared by threads.
#[derive(Debug)]
pub struct Region {
    recorded: bool,
}

/// Runs work that is shared by threads.
pub fn region<R>(share: impl FnOnce(&Region) -> R) -> R {
    let outer = RUNNING.with_borrow_mut(|running| {
        let task = running.last_mut()?;
        task.end_segment();
        Some(std::mem::take(&mut task.ended))
    });
    let result = share(&Region {
        recorded: outer.is_some(),
    });
    if let Some(outer) = outer {
        RUNNING.with_borrow_mut(|running| {
            if let Some(task) = running.last_mut() {
                let tasks = std::mem::replace(&mut task.ended, outer);
                task.trace.0.push(Segment::Parallel(tasks));
                task.since = Instant::now();
            }
        });
    }
    result
}

impl Region {
    /// Runs a task of the region.
    #[inline]
    pub fn task<R>(&self, work: impl FnOnce() -> R) -> R {
        if self.recorded {
            recorded(work)
        } else {
            work()
        }
    }
}

fn recorded<R>(work: impl FnOnce() -> R) -> R {
    RUNNING.with_borrow_mut(|running| running.push(RunningTask::new()));
    let result = work();
    RUNNING.with_borrow_mut(|running| {
        let trace = running.pop().map(RunningTask::end);
        if let Some(outer) = running.last_mut() {
            outer.ended.extend(trace);
        }
    });
    result
}

/// A parallel iterator whose items are processed as tasks of a region.
pub trait InTasks: ParallelIterator {
    /// [`ParallelIterator::for_each`].
    fn each(self, work: impl Fn(Self::Item) + Send + Sync) {
        region(|region| self.for_each(|item| region.task(|| work(item))));
    }

    /// [`ParallelIterator::map`], collected.
    fn gather<C: FromParallelIterator<R>, R: Send>(
        self,
        work: impl Fn(Self::Item) -> R + Send + Sync,
    ) -> C {
        region(|region| self.map(|item| region.task(|| work(item))).collect())
    }
}

impl<I: ParallelIterator> InTasks for I {}

/// [`rayon::join`] as a region of two tasks.
pub fn join<A: Send, B: Send>(
    one: impl FnOnce() -> A + Send,
    two: impl FnOnce() -> B + Send,
) -> (A, B) {
    region(|region| rayon::join(|| region.task(one), || region.task(two)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Describes the regions of a task by their numbers of tasks, recursively.
    fn shape(trace: &TaskTrace) -> String {
        let regions = trace.0.iter().filter_map(|segment| match segment {
            Segment::Serial(_) => None,
            Segment::Parallel(tasks) => Some(format!(
                "({})",
                tasks.iter().map(shape).collect::<Vec<_>>().join(" ")
            )),
        });
        let regions: String = regions.collect();
        if regions.is_empty() {
            "1".into()
        } else {
            regions
        }
    }

    fn work() -> i32 {
        let square = |i| {
            let (one, two) = join(|| i, || i);
            one * two
        };
        let squares: Vec<i32> = (0..3).into_par_iter().gather(square);
        let sum = squares.into_iter().sum();
        join(|| (), || ());
        sum
    }

    #[test]
    fn regions_are_recorded_inside_of_tasks_and_one_after_the_other() {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .unwrap();
        let (sum, trace) = pool.install(|| record(2, work));
        assert_eq!(sum, 5);
        assert_eq!(shape(&trace), "((1 1) (1 1) (1 1))(1 1)");
        // Nothing is recorded afterwards, or for other threads.
        assert_eq!(pool.install(work), 5);
        assert!(RUNNING.with_borrow(Vec::is_empty));
    }
}
