//! What was wrong in the last call that failed, kept for the thread that made it.

use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char};

thread_local! {
    static LAST: RefCell<(CString, CString)> = RefCell::default();
}

/// Keeps what was wrong, and what to do about it.
pub(crate) fn keep(message: &str, hint: &str) {
    let text = |text: &str| CString::new(text.replace('\0', " ")).unwrap_or_default();
    let texts = (text(message), text(hint));
    // A thread that is ending has no place for it any more.
    let _ = LAST.try_with(|last| last.replace(texts));
}

pub(crate) fn last_message() -> *const c_char {
    last(|(message, _)| message)
}

pub(crate) fn last_hint() -> *const c_char {
    last(|(_, hint)| hint)
}

fn last(which: impl FnOnce(&(CString, CString)) -> &CStr) -> *const c_char {
    let text = LAST.try_with(|last| which(&last.borrow()).as_ptr());
    text.unwrap_or(c"".as_ptr())
}
