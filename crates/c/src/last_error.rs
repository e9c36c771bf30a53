//! Message and hint of the last failed call of each thread.

use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char};

thread_local! {
    static LAST: RefCell<(CString, CString)> = RefCell::default();
}

/// Keeps a message and a hint.
pub(crate) fn keep(message: &str, hint: &str) {
    let text = |text: &str| CString::new(text.replace('\0', " ")).unwrap_or_default();
    let texts = (text(message), text(hint));
    // The storage of a thread that is ending may be gone.
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
