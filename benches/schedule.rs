//! Predicts the time of a completion on more cores than the machine has: tasks are recorded on one thread, and their schedule
//! is simulated for 1 to 16 threads. Times measured on one and two threads are printed alongside.
//!
//!     cargo bench --bench schedule -- [WIDTHxHEIGHT [POINTS]]
//!
//! An idle thread takes the newest waiting task, at the measured cost of such a move. Shared memory, caches and power are not
//! modelled, so the predicted time is a lower bound.

#![allow(clippy::print_stdout)]

use lsdc::process::keep_pages;
use lsdc_core::{Completer, Observations, Weights};
use lsdc_eval::data::{Dataset as _, Rooms, RoomsConfig, Split};
use lsdc_eval::predict::scene;
use lsdc_eval::sampling::Pattern;
use lsdc_kernels::schedule::{Segment, TaskTrace, record};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::error::Error;
use std::hint::black_box;
use std::time::{Duration, Instant};

const ROUNDS: usize = 21;
const THREADS: [usize; 5] = [1, 2, 4, 8, 16];

fn main() -> Result<(), Box<dyn Error>> {
    keep_pages();
    let mut args = std::env::args().skip(1).filter(|arg| !arg.starts_with('-'));
    let size = args.next().unwrap_or_else(|| "304x228".into());
    let (width, height) = size.split_once('x').ok_or("a size is WIDTHxHEIGHT")?;
    let points = args.next().map_or(Ok(500), |points| points.parse())?;
    let config = RoomsConfig {
        width: width.parse()?,
        height: height.parse()?,
        ..RoomsConfig::default()
    };
    let frame = Rooms::new(Split::Val, &config)?.load(0)?;
    let points = Observations::from_map(&Pattern::Exactly(points).draw(&frame, 0)?);
    let completer = Completer::new(&Weights::builtin())?;

    let pool = |count| ThreadPoolBuilder::new().num_threads(count).build();
    let (one, two) = (pool(1)?, pool(2)?);
    let cost = cost_of_a_move(&two);
    println!(
        "{size}, {} points; a task that moves to another thread costs {cost:.1?}",
        points.len()
    );
    println!("ms         measured on 1, 2   predicted on {THREADS:?}");
    let prepared = scene(&completer, &frame.rgb)?;
    let completed = prepared.complete(&points)?;
    let all = || {
        let prepared = scene(&completer, black_box(&frame.rgb)).map_err(drop)?;
        let completed = prepared.complete(black_box(&points)).map_err(drop)?;
        completed.depth().map_err(drop)
    };
    report("network", cost, [&one, &two], || {
        scene(&completer, black_box(&frame.rgb))
    });
    report("fit", cost, [&one, &two], || {
        prepared.complete(black_box(&points))
    });
    report("reading", cost, [&one, &two], || completed.depth());
    report("all", cost, [&one, &two], all);
    Ok(())
}

/// Prints the measured and predicted times of `work`.
fn report<R: Send>(
    name: &str,
    cost: Duration,
    pools: [&ThreadPool; 2],
    work: impl Fn() -> R + Sync,
) {
    let measured = pools.map(|pool| {
        pool.install(|| {
            least((0..ROUNDS).map(|_| {
                let start = Instant::now();
                black_box(work());
                start.elapsed()
            }))
        })
    });
    let predicted = THREADS.map(|threads| {
        let trace = || pools[0].install(|| record(threads, || black_box(work()))).1;
        let mut shortest = trace();
        (1..ROUNDS).for_each(|_| shorten(&mut shortest, &trace()));
        simulated(&shortest, threads, cost)
    });
    let list = |times: &[Duration]| {
        let times = times
            .iter()
            .map(|time| format!("{:7.2}", 1e3 * time.as_secs_f64()));
        times.collect::<String>()
    };
    println!("{name:10}{}   {}", list(&measured), list(&predicted));
}

/// Takes the shorter time of each task in two traces of the same work: other processes disturb few tasks of a trace, but some
/// in every trace.
fn shorten(trace: &mut TaskTrace, other: &TaskTrace) {
    for pair in trace.0.iter_mut().zip(&other.0) {
        match pair {
            (Segment::Serial(one), Segment::Serial(other)) => *one = (*one).min(*other),
            (Segment::Parallel(tasks), Segment::Parallel(others)) => {
                let pairs = tasks.iter_mut().zip(others);
                pairs.for_each(|(task, other)| shorten(task, other));
            }
            // Different work.
            _ => {}
        }
    }
}

/// The shortest time, which other processes disturbed least.
fn least(times: impl Iterator<Item = Duration>) -> Duration {
    times.min().unwrap_or_default()
}

fn median(times: impl Iterator<Item = Duration>) -> Duration {
    let mut times: Vec<Duration> = times.collect();
    times.sort_unstable();
    times[times.len() / 2]
}

/// Measures the delay of a task that moves to another thread.
fn cost_of_a_move(two: &ThreadPool) -> Duration {
    const WORK: Duration = Duration::from_micros(200);
    let busy = || {
        let start = Instant::now();
        while start.elapsed() < WORK {
            std::hint::spin_loop();
        }
    };
    two.install(|| {
        median((0..200).map(|_| {
            let start = Instant::now();
            rayon::join(busy, busy);
            start.elapsed().saturating_sub(WORK)
        }))
    })
}

/// A task in the simulation.
struct Job<'a> {
    task: &'a TaskTrace,
    /// Index of the current segment.
    segment: usize,
    /// Number of unfinished tasks of the current segment.
    unfinished: usize,
    parent: Option<usize>,
    /// The thread that spawned it, later the thread that ran it last.
    thread: usize,
}

impl<'a> Job<'a> {
    fn new(task: &'a TaskTrace, parent: Option<usize>, thread: usize) -> Self {
        Self {
            task,
            segment: 0,
            unfinished: 0,
            parent,
            thread,
        }
    }
}

/// Simulates a task on a number of threads, each of which takes the newest job that is ready, and returns its time.
fn simulated(task: &TaskTrace, threads: usize, cost: Duration) -> Duration {
    let mut jobs = vec![Job::new(task, None, 0)];
    let mut ready = vec![0];
    let mut idle: Vec<usize> = (0..threads).rev().collect();
    // End time, thread and job of each running segment.
    let mut ends: BinaryHeap<Reverse<(Duration, usize, usize)>> = BinaryHeap::new();
    let mut now = Duration::ZERO;
    loop {
        while let (Some(&thread), Some(&job)) = (idle.last(), ready.last()) {
            idle.pop();
            ready.pop();
            let own = &mut jobs[job];
            let moves = if own.thread == thread {
                Duration::ZERO
            } else {
                cost
            };
            own.thread = thread;
            let length = match own.task.0.get(own.segment) {
                Some(Segment::Serial(length)) => *length,
                _ => Duration::ZERO,
            };
            ends.push(Reverse((now + moves + length, thread, job)));
        }
        let Some(Reverse((time, thread, mut job))) = ends.pop() else {
            return now;
        };
        now = time;
        idle.push(thread);
        // Continue with the next segment of this job, or of the parents that waited for it.
        loop {
            jobs[job].segment += 1;
            let (task, segment) = (jobs[job].task, jobs[job].segment);
            match task.0.get(segment) {
                Some(Segment::Serial(_)) => {
                    jobs[job].thread = thread;
                    ready.push(job);
                    break;
                }
                Some(Segment::Parallel(tasks)) if !tasks.is_empty() => {
                    jobs[job].unfinished = tasks.len();
                    for task in tasks.iter().rev() {
                        ready.push(jobs.len());
                        jobs.push(Job::new(task, Some(job), thread));
                    }
                    break;
                }
                Some(Segment::Parallel(_)) => {}
                None => {
                    let Some(parent) = jobs[job].parent else {
                        return now;
                    };
                    jobs[parent].unfinished -= 1;
                    if jobs[parent].unfinished > 0 {
                        break;
                    }
                    job = parent;
                }
            }
        }
    }
}
