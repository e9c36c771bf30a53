//! The operation on GPUs.

use super::{PackBackend, Places, reference, reference_part};
use crate::ops::gpu::{cube, cubes};
use burn::backend::tensor::FloatTensor;
use burn::backend::{DType, TensorMetadata as _};
use burn::tensor::Shape;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;

type Floats = FloatTensor<CubeBackend>;

impl PackBackend for CubeBackend {
    fn pack(
        packed: Floats,
        a: Floats,
        b: Floats,
        c: Floats,
        d: Floats,
        e: Floats,
        f: Floats,
        g: Floats,
        places: Places,
    ) -> Floats {
        if packed.dtype() != DType::F32 {
            return reference::<Self>(packed, [a, b, c, d, e, f, g], places);
        }
        let [a, b, c, d, e, f, g] = [a, b, c, d, e, f, g].map(into_contiguous);
        let [
            start_a,
            start_b,
            start_c,
            start_d,
            start_e,
            start_f,
            start_g,
        ] = places.map(|(start, _)| start as u32);
        let lengths = places.map(|(_, length)| length as u32);
        let [
            a_length,
            b_length,
            c_length,
            d_length,
            e_length,
            f_length,
            g_length,
        ] = lengths;
        copy_all::launch(
            &packed.client,
            cubes(&packed, lengths.iter().sum::<u32>() as usize),
            cube(),
            packed.clone().into_buffer_arg(),
            a.into_buffer_arg(),
            b.into_buffer_arg(),
            c.into_buffer_arg(),
            d.into_buffer_arg(),
            e.into_buffer_arg(),
            f.into_buffer_arg(),
            g.into_buffer_arg(),
            start_a,
            start_b,
            start_c,
            start_d,
            start_e,
            start_f,
            start_g,
            a_length,
            b_length,
            c_length,
            d_length,
            e_length,
            f_length,
            g_length,
        );
        packed
    }

    fn part(packed: Floats, start: usize, length: usize) -> Floats {
        let bytes = |values: usize| (values * packed.dtype().size()) as u64;
        let alignment = packed.client.properties().memory.alignment;
        let shape = packed.shape();
        let end = shape.num_elements() - start - length;
        if !bytes(start).is_multiple_of(alignment) || packed.meta.strides()[0] != 1 {
            return reference_part::<Self>(packed, start, length);
        }
        let handle = packed.handle.clone();
        CubeTensor::new_contiguous(
            packed.client.clone(),
            packed.device.clone(),
            Shape::new([length]),
            handle.offset_start(bytes(start)).offset_end(bytes(end)),
            packed.dtype,
        )
    }
}

#[cube(launch)]
fn copy_all(
    packed: &mut [f32],
    a: &[f32],
    b: &[f32],
    c: &[f32],
    d: &[f32],
    e: &[f32],
    f: &[f32],
    g: &[f32],
    a_start: u32,
    b_start: u32,
    c_start: u32,
    d_start: u32,
    e_start: u32,
    f_start: u32,
    g_start: u32,
    a_length: u32,
    b_length: u32,
    c_length: u32,
    d_length: u32,
    e_length: u32,
    f_length: u32,
    g_length: u32,
) {
    let at = ABSOLUTE_POS as u32;
    let first_b = a_length;
    let first_c = first_b + b_length;
    let first_d = first_c + c_length;
    let first_e = first_d + d_length;
    let first_f = first_e + e_length;
    let first_g = first_f + f_length;
    copy(packed, a, at, 0u32, a_length, a_start);
    copy(packed, b, at, first_b, b_length, b_start);
    copy(packed, c, at, first_c, c_length, c_start);
    copy(packed, d, at, first_d, d_length, d_start);
    copy(packed, e, at, first_e, e_length, e_start);
    copy(packed, f, at, first_f, f_length, f_start);
    copy(packed, g, at, first_g, g_length, g_start);
}

/// Copies a value of a part, if the unit has one: units from `first` on have the values of the part.
#[cube]
fn copy(packed: &mut [f32], part: &[f32], at: u32, first: u32, length: u32, start: u32) {
    if at >= first && at < first + length {
        packed[(start + at - first) as usize] = part[(at - first) as usize];
    }
}
