//! The message of a panic, which JavaScript reads after the instance has stopped.
//!
//! A panic of this target ends in a trap, after which the instance cannot be called, but its memory can still be read.

use std::cell::Cell;

/// Size of the message in bytes; longer messages are truncated.
const MOST: usize = 512;

thread_local! {
    /// Null-terminated UTF-8 text.
    static MESSAGE: [Cell<u8>; MOST] = const { [const { Cell::new(0) }; MOST] };
}

/// Starts recording the message of a panic, and returns its address.
pub(crate) fn keep_message() -> *const u8 {
    std::panic::set_hook(Box::new(|info| write(&info.to_string())));
    MESSAGE.with(|message| message.as_ptr().cast())
}

fn write(text: &str) {
    let end = text.floor_char_boundary(MOST - 1);
    MESSAGE.with(|message| {
        let bytes = text.as_bytes()[..end].iter().chain(&[0]);
        bytes
            .zip(message)
            .for_each(|(&byte, place)| place.set(byte));
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kept() -> Vec<u8> {
        let bytes = MESSAGE.with(|message| message.each_ref().map(Cell::get));
        bytes.into_iter().take_while(|&byte| byte != 0).collect()
    }

    #[test]
    fn long_messages_are_cut_off_between_letters() {
        write("longer");
        write("short");
        assert_eq!(kept(), b"short");
        write(&"ä".repeat(MOST));
        // 511 bytes are available, of which letters of two bytes fill 510.
        assert_eq!(kept(), "ä".repeat(255).as_bytes());
    }
}
