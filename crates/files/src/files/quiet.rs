//! Catches the panics of libraries on damaged files.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::sync::Once;

thread_local! {
    /// Whether panics of this thread are caught.
    static CATCHING: Cell<bool> = const { Cell::new(false) };
}

/// Returns the result of `work`, or `None` if it panics.
pub(super) fn catch<T>(work: impl FnOnce() -> T) -> Option<T> {
    let outer = CATCHING.replace(true);
    let result = catch_unwind(AssertUnwindSafe(work)).ok();
    CATCHING.set(outer);
    result
}

/// Hides the messages of panics that readers catch, such as those of damaged LAZ files; all others are reported as before.
///
/// The hook is global to the process, so that only a program should call this, never a library. Without it, readers return
/// the same errors.
pub fn hide_caught_panics() {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let before = take_hook();
        set_hook(Box::new(move |panic| {
            if !CATCHING.get() {
                before(panic);
            }
        }));
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[test]
    fn panics_become_nothing_and_only_a_program_hides_them() {
        static TOLD: AtomicUsize = AtomicUsize::new(0);
        let (before, own) = (take_hook(), std::thread::current().id());
        set_hook(Box::new(move |panic| {
            // Other tests may panic at the same time.
            if std::thread::current().id() == own {
                TOLD.fetch_add(1, Ordering::Relaxed);
            } else {
                before(panic);
            }
        }));
        let damaged = || catch(|| -> u8 { panic!("a damaged record") });
        assert_eq!(catch(|| 3), Some(3));
        assert_eq!((damaged(), TOLD.load(Ordering::Relaxed)), (None, 1));
        hide_caught_panics();
        assert_eq!((damaged(), TOLD.load(Ordering::Relaxed)), (None, 1));
        assert!(!CATCHING.get());
        assert!(std::panic::catch_unwind(|| panic!("another")).is_err());
        assert_eq!(TOLD.load(Ordering::Relaxed), 2);
        let _ = take_hook();
    }
}
