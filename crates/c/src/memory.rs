//! Reading and writing the caller's memory: the only file that dereferences the caller's pointers.
//!
//! Everything is copied byte by byte, so alignment, gaps between rows and overlaps do not matter. The caller promises that
//! pointers lead to as many bytes as their sizes say; this cannot be checked.

use crate::error::{Error, Result};
use std::ffi::{CStr, c_char};
use std::mem::MaybeUninit;
use std::path::PathBuf;

/// No version has larger structures: `struct_size` was not set.
const LARGEST: usize = 4096;

/// Numbers for which any bytes are a valid value.
///
/// # Safety
/// Any bytes are a valid value, and there is no padding.
pub(crate) unsafe trait Plain: Copy {}

// SAFETY: numbers are made of bytes without padding.
unsafe impl Plain for u8 {}
// SAFETY: as above.
unsafe impl Plain for u16 {}
// SAFETY: as above.
unsafe impl Plain for f32 {}
// SAFETY: as above.
unsafe impl Plain for f64 {}

/// Structures that begin with their size in bytes, and to whose end later versions add fields.
///
/// # Safety
/// The type is `repr(C)`, its first field is `struct_size: usize`, and zeros are valid in all other fields.
pub(crate) unsafe trait Versioned: Copy {
    /// Size of the smallest valid structure.
    const LEAST: usize;
}

/// Layout of rows in a buffer, in bytes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RowLayout {
    count: usize,
    /// Bytes of a row.
    row: usize,
    /// Bytes from one row to the next.
    stride: usize,
}

impl RowLayout {
    /// Creates the layout of `count` rows of `row` bytes, `stride` bytes apart (0: no gaps). `what` names the rows in errors.
    pub(crate) fn new(what: &str, count: usize, row: usize, stride: usize) -> Result<Self> {
        let stride = if stride == 0 { row } else { stride };
        if stride < row {
            let message =
                format!("rows of {what} are {row} bytes long and overlap, {stride} bytes apart");
            return Err(
                Error::buffer(message).with_hint("strides are in bytes; 0 means without gaps")
            );
        }
        let rows = Self { count, row, stride };
        match stride.checked_mul(count) {
            Some(all) if isize::try_from(all).is_ok() => Ok(rows),
            _ => {
                let message =
                    format!("{count} rows of {what}, {stride} bytes apart, exceed all memory");
                Err(Error::buffer(message))
            }
        }
    }

    /// Returns the number of bytes from the first to the last.
    fn span(self) -> usize {
        match self.count {
            0 => 0,
            count => self.stride * (count - 1) + self.row,
        }
    }

    /// Checks that the rows fit into `size` bytes.
    pub(crate) fn fit(self, what: &str, size: usize) -> Result<Self> {
        if self.span() <= size {
            return Ok(self);
        }
        let needed = self.span();
        let message = format!("{what} takes {needed} bytes, but its buffer has {size}");
        Err(Error::buffer(message))
    }

    /// Checks that the rows fill `size` bytes: a longer buffer has another format or stride.
    pub(crate) fn fill(self, what: &str, size: usize) -> Result<Self> {
        let all = self.stride * self.count;
        if size > all {
            let message = format!("{what} takes {all} bytes, but its buffer has {size}");
            let hint = "set `stride` if there are gaps between rows, and check `format`";
            return Err(Error::buffer(message).with_hint(hint));
        }
        self.fit(what, size)
    }
}

/// Checks a pointer to `bytes` bytes.
fn check(pointer: *const u8, bytes: usize, what: &str) -> Result<()> {
    if pointer.is_null() {
        return Err(Error::null(what));
    }
    match pointer.addr().checked_add(bytes) {
        Some(_) => Ok(()),
        None => Err(Error::buffer(format!(
            "`{what}` does not have {bytes} bytes: memory ends before"
        ))),
    }
}

/// Calls `read` with a pointer of the caller, unless it is null.
pub(crate) fn unless_null<T, R>(
    pointer: *const T,
    read: impl FnOnce(*const T) -> Result<R>,
) -> Result<Option<R>> {
    (!pointer.is_null()).then(|| read(pointer)).transpose()
}

/// Copies rows of the caller into a vector without gaps.
///
/// # Safety
/// `data` is null or leads to memory with these rows, which nobody writes meanwhile.
pub(crate) unsafe fn gather<T: Plain>(
    data: *const T,
    rows: RowLayout,
    what: &str,
) -> Result<Vec<T>> {
    let RowLayout { count, row, stride } = rows;
    let bytes = row * count;
    let length = bytes / size_of::<T>();
    debug_assert_eq!(length * size_of::<T>(), bytes);
    if bytes == 0 {
        return Ok(Vec::new());
    }
    let data = data.cast::<u8>();
    check(data, rows.span(), what)?;
    let mut values: Vec<T> = Vec::new();
    if values.try_reserve_exact(length).is_err() {
        return Err(Error::memory(bytes));
    }
    let target = values.as_mut_ptr().cast::<u8>();
    for y in 0..count {
        // SAFETY: row `y` lies in the caller's memory, and in the capacity of `values`, which is new.
        unsafe {
            data.add(y * stride)
                .copy_to_nonoverlapping(target.add(y * row), row);
        }
    }
    // SAFETY: all `length` values were copied, and any bytes are a value.
    unsafe { values.set_len(length) };
    Ok(values)
}

/// Copies values without gaps into rows of the caller.
///
/// # Safety
/// `data` is null or leads to memory with these rows, which nobody else uses meanwhile.
pub(crate) unsafe fn scatter<T: Plain>(
    values: &[T],
    data: *mut T,
    rows: RowLayout,
    what: &str,
) -> Result<()> {
    if values.is_empty() {
        return Ok(());
    }
    let data = data.cast::<u8>();
    check(data, rows.span(), what)?;
    let values = values.chunks_exact(rows.row / size_of::<T>());
    for (y, row) in values.take(rows.count).enumerate() {
        let row: *const u8 = row.as_ptr().cast();
        // SAFETY: row `y` lies in the caller's memory, and `row` is ours.
        unsafe { row.copy_to_nonoverlapping(data.add(y * rows.stride), rows.row) };
    }
    Ok(())
}

/// Reads a structure of the caller, of any version: fields that an older one lacks become 0, and additional fields of a
/// newer one must be 0.
///
/// # Safety
/// `from` is null or leads to memory with as many bytes as its `struct_size` says.
pub(crate) unsafe fn structure<T: Versioned>(from: *const T, what: &str) -> Result<T> {
    // SAFETY: the caller's promise.
    let size = unsafe { struct_size(from, what) }?;
    let (from, known) = (from.cast::<u8>(), size.min(size_of::<T>()));
    for place in known..size {
        // SAFETY: the structure has `size` bytes.
        if unsafe { from.add(place).read() } != 0 {
            let message = format!("`{what}` uses a field that this version of lsdc does not know");
            return Err(Error::argument(message).with_hint("install the version of its header"));
        }
    }
    let mut value = MaybeUninit::<T>::zeroed();
    // SAFETY: both have at least `known` bytes, and `value` is new.
    unsafe { from.copy_to_nonoverlapping(value.as_mut_ptr().cast(), known) };
    // SAFETY: zeros and the caller's bytes are valid values: the fields are numbers and pointers.
    Ok(unsafe { value.assume_init() })
}

/// As `structure`, but returns zeros for null.
///
/// # Safety
/// As for `structure`.
pub(crate) unsafe fn optional<T: Versioned>(from: *const T, what: &str) -> Result<T> {
    if from.is_null() {
        // SAFETY: zeros are a valid value.
        return Ok(unsafe { MaybeUninit::zeroed().assume_init() });
    }
    // SAFETY: the caller's promise.
    unsafe { structure(from, what) }
}

/// Fills a structure of the caller, of any version, after its `struct_size`.
///
/// # Safety
/// `to` is null or leads to memory with as many bytes as its `struct_size` says, which nobody else uses
/// meanwhile.
pub(crate) unsafe fn fill<T: Versioned>(to: *mut T, value: &T, what: &str) -> Result<()> {
    // SAFETY: the caller's promise.
    let size = unsafe { struct_size(to, what) }?;
    let (known, first) = (size.min(size_of::<T>()), size_of::<usize>());
    let (from, to) = (std::ptr::from_ref(value).cast::<u8>(), to.cast::<u8>());
    // SAFETY: both have at least `known` bytes, and `value` is ours.
    unsafe {
        from.add(first)
            .copy_to_nonoverlapping(to.add(first), known - first);
    }
    // SAFETY: the caller's structure has `size` bytes.
    unsafe { to.add(known).write_bytes(0, size - known) };
    Ok(())
}

/// Reads and checks the size of a structure.
///
/// # Safety
/// `structure` is null or leads to memory for at least its `struct_size`.
unsafe fn struct_size<T: Versioned>(structure: *const T, what: &str) -> Result<usize> {
    if structure.is_null() {
        return Err(Error::null(what));
    }
    // SAFETY: every structure begins with its size.
    let size = unsafe { structure.cast::<usize>().read_unaligned() };
    if (T::LEAST..=LARGEST).contains(&size) && size.is_multiple_of(size_of::<usize>()) {
        return Ok(size);
    }
    let message = format!("`{what}->struct_size` is {size}, which is no size of that structure");
    Err(Error::argument(message).with_hint("set it to `sizeof` the structure"))
}

/// Writes a value to the caller's memory.
///
/// # Safety
/// `to` is null or leads to memory for a `T`, which nobody else uses meanwhile.
pub(crate) unsafe fn put<T: Copy>(to: *mut T, value: T, what: &str) -> Result<()> {
    check(to.cast(), size_of::<T>(), what)?;
    // SAFETY: not null, and the caller's promise.
    unsafe { to.write_unaligned(value) };
    Ok(())
}

/// Reads a text of the caller.
///
/// # Safety
/// `from` is null or leads to null-terminated bytes.
pub(crate) unsafe fn text(from: *const c_char, what: &str) -> Result<String> {
    // SAFETY: the caller's promise.
    let bytes = unsafe { string(from, what) }?;
    String::from_utf8(bytes).map_err(|_| Error::argument(format!("`{what}` is not UTF-8")))
}

/// Reads a path: any bytes on Unix, otherwise UTF-8.
///
/// # Safety
/// As for `text`.
pub(crate) unsafe fn path(from: *const c_char, what: &str) -> Result<PathBuf> {
    #[cfg(unix)]
    {
        use std::os::unix::ffi::OsStringExt;
        // SAFETY: the caller's promise.
        let bytes = unsafe { string(from, what) }?;
        Ok(std::ffi::OsString::from_vec(bytes).into())
    }
    #[cfg(not(unix))]
    // SAFETY: the caller's promise.
    unsafe { text(from, what) }.map(PathBuf::from)
}

/// # Safety
/// As for `text`.
unsafe fn string(from: *const c_char, what: &str) -> Result<Vec<u8>> {
    if from.is_null() {
        return Err(Error::null(what));
    }
    // SAFETY: not null, and the caller's promise.
    Ok(unsafe { CStr::from_ptr(from) }.to_bytes().to_vec())
}
