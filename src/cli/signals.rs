//! Signals that the program was started to ignore.

/// The signals that ask the program to end, as far as they are ignored.
#[cfg(unix)]
#[allow(unsafe_code)]
pub(super) fn ignored() -> Vec<i32> {
    let is_ignored = |signal: &i32| {
        let mut action = std::mem::MaybeUninit::<libc::sigaction>::zeroed();
        // SAFETY: without a new action the call only fills in the old one, which is plain data.
        unsafe {
            libc::sigaction(*signal, std::ptr::null(), action.as_mut_ptr()) == 0
                && action.assume_init().sa_sigaction == libc::SIG_IGN
        }
    };
    let signals = [libc::SIGHUP, libc::SIGINT, libc::SIGTERM];
    signals.into_iter().filter(is_ignored).collect()
}

/// Ignores signals again.
#[cfg(unix)]
#[allow(unsafe_code)]
pub(super) fn ignore(signals: &[i32]) {
    for &signal in signals {
        // SAFETY: to ignore a signal installs no handler.
        unsafe { libc::signal(signal, libc::SIG_IGN) };
    }
}

#[cfg(not(unix))]
pub(super) fn ignored() -> Vec<i32> {
    Vec::new()
}

#[cfg(not(unix))]
pub(super) fn ignore(_: &[i32]) {}
