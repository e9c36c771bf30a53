//! Metadata in chunks of PNG and WebP files.

/// Returns the data of the first chunk of a kind before the pixels of a PNG.
fn png_chunk(bytes: &[u8], kind: [u8; 4]) -> Option<&[u8]> {
    let mut rest = bytes.strip_prefix(b"\x89PNG\r\n\x1a\n")?;
    loop {
        let (length, after) = rest.split_first_chunk::<4>()?;
        let (found, after) = after.split_first_chunk::<4>()?;
        let length = u32::from_be_bytes(*length) as usize;
        if *found == kind {
            return after.get(..length);
        }
        if found == b"IDAT" {
            return None;
        }
        // The checksum follows the data.
        rest = after.get(length.checked_add(4)?..)?;
    }
}

/// Returns the offset of a PNG in a larger picture, if it is not 0 (chunk oFFs; Extensions to the PNG 1.2 specification,
/// section 3.1).
pub(super) fn offset(bytes: &[u8]) -> Option<[i64; 2]> {
    let numbers = png_chunk(bytes, *b"oFFs")?.as_chunks::<4>().0.get(..2)?;
    let offset = [numbers[0], numbers[1]].map(|number| i64::from(i32::from_be_bytes(number)));
    (offset != [0, 0]).then_some(offset)
}

/// Returns the number of frames of an animation; 1 for other files (chunk acTL of PNG, chunks ANMF of WebP).
pub(super) fn frames(bytes: &[u8]) -> usize {
    if let Some(number) = png_chunk(bytes, *b"acTL").and_then(|data| data.first_chunk()) {
        return (u32::from_be_bytes(*number) as usize).max(1);
    }
    let webp = bytes
        .strip_prefix(b"RIFF")
        .and_then(|rest| rest.get(4..)?.strip_prefix(b"WEBP"));
    let mut frames = 0;
    let mut rest = webp.unwrap_or_default();
    while let Some((kind, after)) = rest.split_first_chunk::<4>() {
        let Some((length, after)) = after.split_first_chunk::<4>() else {
            break;
        };
        frames += usize::from(kind == b"ANMF");
        let length = u32::from_le_bytes(*length) as usize;
        rest = after
            .get(length.saturating_add(length % 2)..)
            .unwrap_or_default();
    }
    frames.max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_of_animations_are_counted() {
        let png = |kind: &[u8; 4], data: &[u8]| {
            let length = (data.len() as u32).to_be_bytes();
            [
                b"\x89PNG\r\n\x1a\n",
                &length[..],
                kind,
                data,
                &[0; 4],
                &[0, 0, 0, 0],
                b"IDAT",
            ]
            .concat()
        };
        assert_eq!(frames(&png(b"acTL", &[0, 0, 0, 7, 0, 0, 0, 0])), 7);
        assert_eq!(frames(&png(b"tEXt", b"a")), 1);
        assert_eq!(
            offset(&png(b"oFFs", &[0, 0, 0, 9, 255, 255, 255, 255, 0])),
            Some([9, -1])
        );
        assert_eq!(offset(&png(b"oFFs", &[0; 9])), None);
        let frame = b"ANMF\x03\0\0\0abc\0";
        let webp = [&b"RIFF\0\0\0\0WEBPVP8X\0\0\0\0"[..], frame, frame].concat();
        assert_eq!(frames(&webp), 2);
        for end in 0..webp.len() {
            let _ = frames(&webp[..end]);
        }
        assert_eq!(frames(b""), 1);
    }
}
