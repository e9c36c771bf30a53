//! Sparse models of COLMAP: the first byte selects the file that contains the other bytes.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_files::{Colmap, Sparse};
use lsdc_fuzz::with_file;
use std::fs::write;

fuzz_target!(|data: &[u8]| {
    let Some((&which, data)) = data.split_first() else {
        return;
    };
    let endings = [["bin", "txt"], ["txt", "txt"]][usize::from(which & 1)];
    let names = ["cameras", "images", "points3D", "rigs", "frames"];
    let own = usize::from(which >> 1) % names.len();
    with_file(data, &format!("{}.{}", names[own], endings[0]), |path| {
        let sound = [
            "1 PINHOLE 64 48 50 50 32 24\n",
            "1 1 0 0 0 0 0 0 1 a.png\n3 4 1\n",
            "1 0 0 5 0 0 0 0.5 1 0\n",
            "1 1 CAMERA 1\n",
            "1 1 1 0 0 0 0 0 0 1 CAMERA 1 1\n",
        ];
        for (name, text) in names.iter().zip(sound) {
            if *name != names[own] {
                write(path.with_file_name(format!("{name}.txt")), text).expect("a file");
            }
        }
        // Rigs and frames have the same format as the images.
        if own > 2 && endings[0] == "bin" {
            for name in &names[..3] {
                write(path.with_file_name(format!("{name}.bin")), [0; 8]).expect("a file");
            }
        }
        let folder = path.parent().expect("a folder");
        for view in Colmap::read(folder).into_iter().flat_map(|m| m.views) {
            let _ = Sparse::of_view(&view, (64, 48), None);
        }
    });
});
