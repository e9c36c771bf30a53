//! Writes laser scans: an image, and a file with its returns.

use image::RgbImage;
use npyz::{AutoSerialize, WriteOptions, WriterBuilder as _};
use std::fs::File;
use std::path::Path;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

/// One return: column and row in pixels, depth in metres, ring.
pub(crate) type Return = (f32, f32, f32, i16);

/// Writes `NAME.png` and `NAME_points.npz`, without the array `ring` if all rings are -1.
pub(crate) fn write_scan(folder: &Path, name: &str, image: &RgbImage, returns: &[Return]) {
    let path = folder.join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    image.save(folder.join(format!("{name}.png"))).unwrap();
    let file = File::create(folder.join(format!("{name}_points.npz"))).unwrap();
    let mut archive = ZipWriter::new(file);
    write_list(&mut archive, "u", returns.iter().map(|r| r.0));
    write_list(&mut archive, "v", returns.iter().map(|r| r.1));
    write_list(&mut archive, "depth", returns.iter().map(|r| r.2));
    if returns.iter().any(|r| r.3 >= 0) {
        write_list(&mut archive, "ring", returns.iter().map(|r| r.3));
    }
    archive.finish().unwrap();
}

/// Adds an array of shape `(n,)` to an archive.
pub(crate) fn write_list<T: AutoSerialize>(
    archive: &mut ZipWriter<File>,
    name: &str,
    values: impl ExactSizeIterator<Item = T>,
) {
    let options = SimpleFileOptions::default();
    archive.start_file(format!("{name}.npy"), options).unwrap();
    let shape = [values.len() as u64];
    let options = WriteOptions::new().default_dtype().shape(&shape);
    let mut writer = options.writer(archive).begin_nd().unwrap();
    writer.extend(values).unwrap();
    writer.finish().unwrap();
}
