//! Damaged copies of sound requests never cause a panic.

use lsdc_serve::fuzzing::{form, text};

/// Returns the next number of a pseudorandom sequence (Marsaglia 2003, xorshift).
fn next(state: &mut u64) -> usize {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    (*state >> 16) as usize
}

/// Returns the bytes with some of them changed, removed or repeated.
fn damaged(bytes: &[u8], state: &mut u64) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..=next(state) % 4 {
        if bytes.is_empty() {
            break;
        }
        let (at, length) = (next(state) % bytes.len(), 1 + next(state) % 16);
        let end = (at + length).min(bytes.len());
        match next(state) % 4 {
            0 => bytes[at] ^= 1 << (next(state) % 8),
            1 => drop(bytes.drain(at..end)),
            2 => {
                let again = bytes[at..end].to_vec();
                bytes.splice(at..at, again);
            }
            _ => bytes.truncate(at.max(1)),
        }
    }
    bytes
}

#[test]
fn damaged_forms_and_texts_are_refused_or_read() {
    let rgb = include_bytes!("data/small.png");
    let parts: [(&str, &str, &[u8]); 4] = [
        ("image", "; filename=\"a.png\"", rgb),
        (
            "points",
            "; filename=\"a.csv\"",
            b"u,v,depth\n1,2,0.5\n3,3,0.7\n",
        ),
        ("camera", "", b"5,5,2,2"),
        (
            "options",
            "",
            b"{\"robust\": \"auto\", \"sigma\": 0.1, \"layers\": [\"depth\"]}",
        ),
    ];
    let mut body = Vec::new();
    for (name, file, bytes) in parts {
        let head = format!("--b\r\ncontent-disposition: form-data; name=\"{name}\"{file}\r\n\r\n");
        body.extend([head.as_bytes(), bytes, b"\r\n"].concat());
    }
    body.extend(b"--b--\r\n");
    let kind = "multipart/form-data; boundary=b";
    assert!(form(kind, &body), "a sound form");
    let points = b"[[1, 2, 0.5], [3, 3, 0.7, 0.01], [4, 1, 1e-3, null]]";
    let mut state = 0x9e37_79b9_7f4a_7c15;
    let mut read = 0;
    for _ in 0..600 {
        read += usize::from(form(kind, &damaged(&body, &mut state)));
        text(&damaged(points, &mut state));
        text(&damaged(parts[3].2, &mut state));
    }
    // Some damaged forms can still be read, most cannot.
    assert!((1..400).contains(&read), "{read}");
}
