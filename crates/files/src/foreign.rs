//! Recognises unsupported kinds of files, to give a hint for them.

use crate::error::{Error, Result};
use crate::files::has_ending;
use std::fs::File;
use std::io::Read as _;
use std::path::Path;

/// File extensions of videos.
const VIDEOS: [&str; 10] = [
    "mp4", "mov", "mkv", "avi", "webm", "m4v", "mpg", "mpeg", "wmv", "flv",
];

/// The brands of pictures in the ISO base media file format (ISO/IEC 23008-12, annex B; AV1 image file format).
const HEIC: [&[u8; 4]; 8] = [
    b"heic", b"heix", b"hevc", b"heim", b"heis", b"mif1", b"msf1", b"hevx",
];
const AVIF: [&[u8; 4]; 2] = [b"avif", b"avis"];

/// Accepts files that may be supported, and files that cannot be opened.
///
/// # Errors
/// The file is a video, HEIC, AVIF or GIF, by its first bytes or its extension; the hint converts it.
pub fn check_foreign(path: &Path) -> Result<()> {
    // Bytes read from a pipe would be lost.
    if !path.is_file() {
        return Ok(());
    }
    let mut head = Vec::new();
    let read = File::open(path).and_then(|file| file.take(16).read_to_end(&mut head));
    if read.is_err() {
        return Ok(());
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let brand = head.get(8..12).filter(|_| head.get(4..8) == Some(b"ftyp"));
    let is = |brands: &[&[u8; 4]]| {
        brand.is_some_and(|brand| brands.iter().any(|known| known[..] == *brand))
    };
    let (what, hint) = if is(&HEIC) {
        (
            "is a HEIC image (HEIF), which is not read",
            format!(
                "convert it: `heif-convert {name} image.png`, or in folders with ImageMagick, `mogrify -format png *.heic`"
            ),
        )
    } else if is(&AVIF) {
        (
            "is an AVIF image, which is not read",
            format!("convert it: `avifdec {name} image.png`, or `ffmpeg -i {name} image.png`"),
        )
    } else if head.starts_with(b"GIF8") {
        (
            "is a GIF, which is not read",
            format!("convert its first frame: `ffmpeg -i {name} -frames:v 1 image.png`"),
        )
    } else if is_video(path, &head, brand.is_some()) {
        let frames = path.with_extension("");
        let frames = frames
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        (
            "is a video",
            format!(
                "take its frames: `mkdir {frames}; ffmpeg -i {name} {frames}/%05d.png`, and give the folder `{frames}`"
            ),
        )
    } else {
        return Ok(());
    };
    Err(Error::format(path, what).hint(hint))
}

fn is_video(path: &Path, head: &[u8], is_media: bool) -> bool {
    let matroska = head.starts_with(&[0x1a, 0x45, 0xdf, 0xa3]);
    let avi = head.starts_with(b"RIFF") && head.get(8..12) == Some(b"AVI ");
    let by_content = is_media || matroska || avi;
    by_content || VIDEOS.iter().any(|ending| has_ending(path, ending))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn videos_and_pictures_of_phones_are_named_with_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        for (name, head, what, hint) in [
            (
                "drive.mp4",
                &b"\0\0\0\x20ftypisom"[..],
                "a video",
                "ffmpeg -i",
            ),
            (
                "drive.png",
                b"\0\0\0\x14ftypqt  ",
                "a video",
                "drive/%05d.png",
            ),
            ("a.mkv", &[0x1a, 0x45, 0xdf, 0xa3, 1], "a video", "ffmpeg"),
            ("a.avi", b"RIFF\0\0\0\0AVI LIST", "a video", "ffmpeg"),
            ("a.mov", b"", "a video", "ffmpeg"),
            ("IMG_1.HEIC", b"\0\0\0\x18ftypheic", "HEIC", "heif-convert"),
            ("IMG_2.jpg", b"\0\0\0\x18ftypmif1", "HEIC", "heif-convert"),
            ("a.avif", b"\0\0\0\x18ftypavif", "AVIF", "ffmpeg"),
            ("a.gif", b"GIF89a", "GIF", "ffmpeg"),
        ] {
            let path = folder.path().join(name);
            std::fs::write(&path, head).unwrap();
            let error = check_foreign(&path).unwrap_err();
            assert!(error.to_string().contains(what), "{error}");
            assert!(error.advice().unwrap().contains(hint), "{error:?}");
        }
        for (name, head) in [
            ("a.png", &b"\x89PNG"[..]),
            ("a.npy", b"\x93NUMPY"),
            ("a.webp", b"RIFF\0\0\0\0WEBP"),
        ] {
            let path = folder.path().join(name);
            std::fs::write(&path, head).unwrap();
            assert!(check_foreign(&path).is_ok(), "{name}");
        }
        assert!(check_foreign(&folder.path().join("missing.mp4")).is_ok());
    }
}
