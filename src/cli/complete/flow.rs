//! Many frames: reading, network, fit and writing at the same time, each of another frame.

use super::failures::Failures;
use super::frame::{Completed, Engine, Fitted, Prepared};
use super::loaded::Loaded;
use lsdc_files::error::{Cause, Error, Result};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::sync_channel;
use std::thread::ScopedJoinHandle;

/// Frames that wait between two stages.
const WAITING: usize = 2;

/// A frame after the network: nothing if that failed.
type Seen<'a, F, L> = Option<(&'a F, L, Loaded, Prepared)>;

/// Brings frames through four stages in their order, each on a thread of its own; the network on several, which take turns,
/// where a GPU would idle between two frames of one. `load` may find something that `write` needs. What fails in a stage is
/// left out of those after it.
pub(super) fn run<F: Sync, L: Send>(
    frames: &[F],
    engine: &Engine<'_>,
    (failures, stop): (&Failures, &AtomicBool),
    name: impl Fn(&F) -> &Path + Sync,
    load: impl Fn(&F) -> Result<(L, Loaded)> + Send,
    mut fit: impl FnMut(&F, &Loaded, Prepared) -> Result<Fitted>,
    mut write: impl FnMut(&F, L, &Loaded, &Completed) -> Result<()> + Send,
) -> Result<()> {
    let name = &name;
    std::thread::scope(|scope| {
        let workers = engine.images_at_once();
        let waiting = WAITING.div_ceil(workers);
        let channels = (0..workers).map(|_| sync_channel::<(&F, L, Loaded)>(waiting));
        let (send_read, read): (Vec<_>, Vec<_>) = channels.unzip();
        let channels = (0..workers).map(|_| sync_channel::<Seen<'_, F, L>>(1));
        let (send_prepared, prepared): (Vec<_>, Vec<_>) = channels.unzip();
        let (send_fitted, fitted) = sync_channel::<(&F, L, Loaded, Fitted)>(1);
        let reader = scope.spawn(move || {
            let mut turns = send_read.iter().cycle();
            for frame in frames {
                if stop.load(Ordering::Relaxed) {
                    break;
                }
                match load(frame) {
                    Ok((found, loaded)) => {
                        let worker = turns.next();
                        if worker.is_none_or(|w| w.send((frame, found, loaded)).is_err()) {
                            break;
                        }
                    }
                    Err(error) => failures.add(name(frame), &error),
                }
            }
        });
        let networks = read.into_iter().zip(send_prepared).map(|(read, send)| {
            scope.spawn(move || {
                for (frame, found, loaded) in read {
                    let seen = match engine.prepare(&loaded) {
                        Ok(prepared) => Some((frame, found, loaded, prepared)),
                        Err(error) => {
                            failures.add(name(frame), &error);
                            None
                        }
                    };
                    if send.send(seen).is_err() {
                        break;
                    }
                }
            })
        });
        let networks: Vec<_> = networks.collect();
        let writer = scope.spawn(move || {
            for (frame, found, loaded, fitted) in fitted {
                let completed = engine.finish(&loaded.rgb, &loaded.points, fitted);
                let written = completed.and_then(|done| write(frame, found, &loaded, &done));
                if let Err(error) = written {
                    failures.add(name(frame), &error);
                }
            }
        });
        // The first whose turn it is and who has no more ends them all.
        let seen = prepared
            .iter()
            .cycle()
            .map_while(|worker| worker.recv().ok());
        for (frame, found, loaded, prepared) in seen.flatten() {
            match fit(frame, &loaded, prepared) {
                Ok(fitted) => {
                    if send_fitted.send((frame, found, loaded, fitted)).is_err() {
                        break;
                    }
                }
                Err(error) => failures.add(name(frame), &error),
            }
        }
        drop((send_fitted, prepared));
        finished(writer)?;
        networks.into_iter().try_for_each(finished)?;
        finished(reader)
    })
}

/// Joins a thread, and returns its result.
pub(super) fn finished<T>(thread: ScopedJoinHandle<'_, T>) -> Result<T> {
    thread.join().map_err(|_| {
        Error::new(
            Cause::Write,
            "a part of the program broke off, so that frames are missing",
        )
        .hint("the lines above say where; the same command goes on with what is left")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_panics_is_an_error() {
        let result =
            std::thread::scope(|scope| finished(scope.spawn(|| -> usize { panic!("full") })));
        assert_eq!(result.unwrap_err().cause(), Cause::Write);
        let result = std::thread::scope(|scope| finished(scope.spawn(|| 3)));
        assert_eq!(result.unwrap(), 3);
    }
}
