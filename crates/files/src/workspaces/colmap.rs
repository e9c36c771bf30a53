//! COLMAP's dense workspace (`src/colmap/mvs/workspace.h`): depth and normal maps as its `patch_match_stereo` writes them, and
//! the lists that `stereo_fusion` and the meshers read.

use super::normals::normals;
use lsdc_core::DepthMap;

/// The folders of depth and of normal maps.
pub(super) const PATHS: [&str; 2] = ["stereo/depth_maps", "stereo/normal_maps"];

/// Text after the name of an image in `patch-match.cfg`: its source images, as `colmap image_undistorter` writes them.
const SOURCES: &str = "\n__auto__, 20\n";

/// Returns the files of the depth map and of the normal map of an image, and the number of pixels with a depth but no
/// normal.
pub(super) fn maps(depth: &DepthMap, intrinsics: [f64; 4]) -> ([Vec<u8>; 2], usize) {
    let normals = normals(depth, intrinsics);
    let found = normals.iter().filter(|normal| normal.is_some()).count();
    let size = (depth.width(), depth.height());
    let component = |i: usize| {
        let normals = normals.iter();
        normals.map(move |normal| normal.map_or(0.0, |normal| normal[i] as f32))
    };
    let depths = matrix(size, 1, depth.values().iter().copied());
    let normals = matrix(size, 3, (0..3).flat_map(component));
    ([depths, normals], depth.count() - found)
}

/// Encodes a file of COLMAP's `Mat<float>`: `width&height&channels&`, then 32-bit floats, little-endian, channel by channel
/// and row by row.
fn matrix(
    (width, height): (usize, usize),
    channels: usize,
    values: impl Iterator<Item = f32>,
) -> Vec<u8> {
    let mut bytes = format!("{width}&{height}&{channels}&").into_bytes();
    bytes.reserve(4 * width * height * channels);
    bytes.extend(values.flat_map(f32::to_le_bytes));
    bytes
}

/// Returns the lists of the images with depth, by their paths.
pub(super) fn lists<'a>(
    names: impl Iterator<Item = &'a str> + Clone,
) -> [(&'static str, String); 2] {
    let list = |end: &str| {
        let mut text = String::new();
        for name in names.clone() {
            text.extend([name, end]);
        }
        text
    };
    [
        ("stereo/fusion.cfg", list("\n")),
        ("stereo/patch-match.cfg", list(SOURCES)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_have_the_layout_of_colmap() {
        // The plane z = 2: normals face the camera.
        let mut values = vec![2.0; 12];
        values[5] = 0.0;
        let depth = DepthMap::new(4, 3, values).unwrap();
        let ([depths, normals], without) = maps(&depth, [10.0, 10.0, 1.5, 1.0]);
        let head = b"4&3&1&";
        assert_eq!(&depths[..head.len()], head);
        let numbers = |bytes: &[u8]| -> Vec<f32> {
            let (chunks, rest) = bytes.as_chunks::<4>();
            assert!(rest.is_empty());
            chunks.iter().copied().map(f32::from_le_bytes).collect()
        };
        assert_eq!(numbers(&depths[head.len()..]), depth.values());
        assert_eq!(&normals[..head.len()], b"4&3&3&");
        let normals = numbers(&normals[head.len()..]);
        assert!(normals[..24].iter().all(|v| v.abs() < 1e-6));
        // The pixel without depth, and the pixels for which it is the only neighbour in a row or a column.
        let none = |i: usize| [1, 4, 5, 9].contains(&i);
        let z: Vec<f32> = (0..12).map(|i| if none(i) { 0.0 } else { -1.0 }).collect();
        assert_eq!(&normals[24..], z);
        assert_eq!(without, 3);
    }

    #[test]
    fn lists_name_the_images() {
        let [(_, fusion), (_, sources)] = lists(["a.jpg", "b/c.jpg"].into_iter());
        assert_eq!(fusion, "a.jpg\nb/c.jpg\n");
        assert_eq!(sources, "a.jpg\n__auto__, 20\nb/c.jpg\n__auto__, 20\n");
    }
}
