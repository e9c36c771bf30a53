//! Memory settings of the process: for training, and for the completion of a single image.

/// Prepares the process for training; completing depth needs nothing of this.
///
/// - burn reads the optimiser of a checkpoint on its default device before it moves it to that of the
///   run. The default would be a GPU, and the program would end where there is none: the variable
///   `BURN_DEVICE` makes it the CPU.
/// - glibc keeps the pages of freed tensors: to hand them back and to fault them in again takes longer
///   than to compute a training step (measured: 2.0 s instead of 1.2 s).
///
/// # Safety
/// No other thread may run yet: call it first in `main`.
pub unsafe fn prepare() {
    // SAFETY: no other thread runs, as the caller promises.
    unsafe { std::env::set_var("BURN_DEVICE", "flex") };
    keep_pages();
}

/// Lets glibc keep the pages of freed tensors, as [`prepare`] does; it changes nothing where the C library is another.
pub fn keep_pages() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    for (option, value) in [
        // The most that older versions accept, then more.
        (libc::M_MMAP_THRESHOLD, 32 << 20),
        (libc::M_MMAP_THRESHOLD, i32::MAX),
        (libc::M_TRIM_THRESHOLD, i32::MAX),
        (libc::M_TOP_PAD, 64 << 20),
    ] {
        // SAFETY: the call takes two numbers; a refused option changes nothing.
        unsafe { libc::mallopt(option, value) };
    }
}

/// Hands freed pages back to the system, which [`keep_pages`] prevents otherwise: those of one stage, before the next needs
/// others. It changes nothing where the C library is not glibc.
pub fn give_back_pages() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: the call takes a number, and may be made while other threads run.
    unsafe {
        libc::malloc_trim(0);
    }
}

/// Keeps memory small in a process that completes a single image. Best called before other threads start; it changes nothing
/// where the C library is not glibc.
///
/// - All threads take memory from one heap: what one thread gives back then serves the others. With a heap for each thread,
///   300,000 points need a third more memory.
/// - Large blocks, such as the factor of the field, are mappings of their own, which leave no holes in the heap, and freed
///   pages go back to the system, unlike after [`keep_pages`]: 7 MB less at 640x480 pixels, 18 MB at 12 megapixels.
pub fn share_heap() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    for (option, value) in [
        (libc::M_ARENA_MAX, 1),
        (libc::M_MMAP_THRESHOLD, 2 << 20),
        (libc::M_TRIM_THRESHOLD, 1 << 20),
        (libc::M_TOP_PAD, 128 << 10),
    ] {
        // SAFETY: the call takes two numbers, and may be made while other threads run.
        unsafe { libc::mallopt(option, value) };
    }
}
