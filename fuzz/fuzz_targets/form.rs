//! Forms of the service: parts, files in them, points and options as JSON.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_serve::fuzzing::{form, text};

fuzz_target!(|data: &[u8]| {
    let Some((&kind, data)) = data.split_first() else {
        return;
    };
    match kind % 3 {
        0 => text(data),
        1 => {
            form("multipart/form-data; boundary=b", data);
        }
        // Random bytes are not a form: use them as the parts of a valid one.
        _ => {
            let mut parts = data.splitn(4, |&byte| byte == b'|');
            let mut body = Vec::new();
            let names = [
                ("image", "f.png"),
                ("points", "f.csv"),
                ("camera", "f.toml"),
                ("options", "f.json"),
            ];
            for ((name, file), part) in names.into_iter().zip(&mut parts) {
                let head = format!(
                    "--b\r\ncontent-disposition: form-data; name=\"{name}\"; filename=\"{file}\"\r\n\r\n"
                );
                body.extend([head.as_bytes(), part, b"\r\n"].concat());
            }
            body.extend(b"--b--\r\n");
            form("multipart/form-data; boundary=b", &body);
        }
    }
});
