//! Input and output of a network that another program runs.

use crate::completer::{COMPLETERS, lsdc_completer};
use crate::error::{Error, Result, guard};
use crate::input::{Pixels, checked_size, lsdc_image};
use crate::memory::{self, RowLayout, Versioned};
use crate::status::lsdc_status;
use lsdc_core::NetworkOutput;

/// Basis functions and affinities of an image, computed by another program, such as ONNX Runtime with the graph of
/// `lsdc weights export`. Set `struct_size` to `sizeof(lsdc_network_output)`.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct lsdc_network_output {
    /// `sizeof(lsdc_network_output)`.
    pub struct_size: usize,
    /// The output `basis` of the graph: `functions` maps of `height` rows of `width` values, without gaps.
    pub basis: *const f32,
    /// The output `affinities`: two such maps, of each pixel with its right and its lower neighbour. Not negative.
    pub affinities: *const f32,
    /// Number of basis functions, which must match the completer's weights.
    pub functions: usize,
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
}

// SAFETY: it is `repr(C)`, begins with its size, and consists of numbers and pointers, which may be 0.
unsafe impl Versioned for lsdc_network_output {
    const LEAST: usize = size_of::<Self>();
}

/// Writes the size of the network input for an image of `image_width` columns and `image_height` rows.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_completer_network_size(
    completer: *const lsdc_completer,
    image_width: usize,
    image_height: usize,
    width: *mut usize,
    height: *mut usize,
) -> lsdc_status {
    guard(|| {
        let completer = COMPLETERS.get(completer)?.value;
        checked_size("an image", image_width, image_height)?;
        if height.is_null() {
            return Err(Error::null("height"));
        }
        let size = completer.network_size(image_width, image_height);
        // SAFETY: the caller's promise.
        unsafe {
            memory::put(width, size.0, "width")?;
            memory::put(height, size.1, "height")
        }
    })
}

/// Writes an image as input of the graph of `lsdc weights export`: maps of red, green and blue from 0 to 1, without
/// gaps, each of the size from `lsdc_completer_network_size`. `size` is the number of bytes from `values` to the end of
/// the buffer. If the call fails, the buffer is unchanged.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_completer_network_input(
    completer: *const lsdc_completer,
    image: *const lsdc_image,
    values: *mut f32,
    size: usize,
) -> lsdc_status {
    guard(|| {
        let completer = COMPLETERS.get(completer)?;
        // SAFETY: the caller's promise.
        let pixels = unsafe { Pixels::read(image) }?;
        let input = completer.run(|completer| Ok(completer.network_input(&pixels.image()?)?))?;
        let what = "the input of the network";
        let rows = RowLayout::new(what, 1, size_of_val(input.values.as_slice()), 0)?;
        let rows = rows.fit(what, size)?;
        // SAFETY: the caller's promise.
        unsafe { memory::scatter(&input.values, values, rows, "values") }
    })
}

/// Copies the output of the caller.
///
/// # Safety
/// `output` is null, or it and its maps are as large as they say, and nobody writes them meanwhile.
pub(crate) unsafe fn network_output(output: *const lsdc_network_output) -> Result<NetworkOutput> {
    // SAFETY: the caller's promise.
    let output = unsafe { memory::structure(output, "options->output") }?;
    let (width, height) = (output.width, output.height);
    checked_size("the output of a network", width, height)?;
    let maps = |data: *const f32, count: usize, what: &str| {
        let rows = RowLayout::new(
            &format!("`{what}`"),
            count,
            width * height * size_of::<f32>(),
            0,
        )?;
        // SAFETY: the caller's promise.
        unsafe { memory::gather(data, rows, what) }
    };
    let basis = maps(output.basis, output.functions, "options->output->basis")?;
    let affinities = maps(output.affinities, 2, "options->output->affinities")?;
    Ok(NetworkOutput::new(width, height, basis, affinities)?)
}
