//! What a computation runs in parallel: recorded on one thread, it tells how long many would take.
//!
//! Where threads share work there is a [`region`], and each share is a [task](Region::task) of it; [`InTasks`] makes them of
//! parallel iterators. Unless [`record`] is running, both cost a look at a variable of the thread.
//!
//! ```
//! use lsdc_kernels::schedule::{InTasks, Part, record};
//! use rayon::prelude::*;
//!
//! let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
//! let squares = || [1, 2].par_iter().gather::<Vec<i32>, _>(|number| number * number);
//! let (squares, work) = pool.install(|| record(2, squares));
//! assert_eq!(squares, [1, 4]);
//! assert!(matches!(&work.0[..], [_, Part::Parallel(tasks), _] if tasks.len() == 2));
//! # Ok::<(), rayon::ThreadPoolBuildError>(())
//! ```

use rayon::prelude::*;
use std::cell::{Cell, RefCell};
use std::time::{Duration, Instant};

/// Work that one thread does, part by part.
#[derive(Clone, Debug, Default)]
pub struct Task(pub Vec<Part>);

/// A part of a task.
#[derive(Clone, Debug)]
pub enum Part {
    /// Nothing of it is shared.
    Serial(Duration),
    /// Tasks that threads share; the next part begins when all have ended.
    Parallel(Vec<Task>),
}

/// The task that runs, with the time at which its last part began, and the tasks of the region that it is in.
struct Running {
    task: Task,
    since: Instant,
    siblings: Vec<Task>,
}

thread_local! {
    /// From the outermost task to the one that runs. Empty: nothing is recorded.
    static RUNNING: RefCell<Vec<Running>> = const { RefCell::new(Vec::new()) };
    /// For how many threads work is cut while it is recorded.
    static THREADS: Cell<usize> = const { Cell::new(1) };
}

impl Running {
    fn new() -> Self {
        Self {
            task: Task::default(),
            since: Instant::now(),
            siblings: Vec::new(),
        }
    }

    fn end_part(&mut self) {
        self.task.0.push(Part::Serial(self.since.elapsed()));
    }
}

/// Runs `work`, which should share nothing with other threads (in a pool of one thread), cut for so many threads, and returns
/// what it is made of.
pub fn record<R>(threads: usize, work: impl FnOnce() -> R) -> (R, Task) {
    THREADS.set(threads);
    let before =
        RUNNING.with_borrow_mut(|running| std::mem::replace(running, vec![Running::new()]));
    let result = work();
    let mut found = RUNNING.with_borrow_mut(|running| std::mem::replace(running, before));
    let mut task = found.pop();
    if let Some(running) = &mut task {
        running.end_part();
    }
    (result, task.map(|running| running.task).unwrap_or_default())
}

/// For how many threads work is to be cut: those of the pool, unless it is being recorded.
pub fn threads() -> usize {
    if RUNNING.with_borrow(Vec::is_empty) {
        rayon::current_num_threads()
    } else {
        THREADS.get()
    }
}

/// Work that threads share.
#[derive(Debug)]
pub struct Region {
    recorded: bool,
}

/// Shares work among threads.
pub fn region<R>(share: impl FnOnce(&Region) -> R) -> R {
    let outer = RUNNING.with_borrow_mut(|running| {
        let running = running.last_mut()?;
        running.end_part();
        Some(std::mem::take(&mut running.siblings))
    });
    let result = share(&Region {
        recorded: outer.is_some(),
    });
    if let Some(outer) = outer {
        RUNNING.with_borrow_mut(|running| {
            if let Some(running) = running.last_mut() {
                let tasks = std::mem::replace(&mut running.siblings, outer);
                running.task.0.push(Part::Parallel(tasks));
                running.since = Instant::now();
            }
        });
    }
    result
}

impl Region {
    /// A task of the region.
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
    RUNNING.with_borrow_mut(|running| running.push(Running::new()));
    let result = work();
    RUNNING.with_borrow_mut(|running| {
        if let Some(mut ended) = running.pop() {
            ended.end_part();
            if let Some(outer) = running.last_mut() {
                outer.siblings.push(ended.task);
            }
        }
    });
    result
}

/// A parallel iterator each of whose items is a task of a region.
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

    /// The numbers of tasks of the regions of a task, each with those of its tasks.
    fn shape(task: &Task) -> String {
        let regions = task.0.iter().filter_map(|part| match part {
            Part::Serial(_) => None,
            Part::Parallel(tasks) => Some(format!(
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
        let (sum, task) = pool.install(|| record(2, work));
        assert_eq!(sum, 5);
        assert_eq!(shape(&task), "((1 1) (1 1) (1 1))(1 1)");
        // Nothing is recorded afterwards, or by others.
        assert_eq!(pool.install(work), 5);
        assert!(RUNNING.with_borrow(Vec::is_empty));
    }
}
