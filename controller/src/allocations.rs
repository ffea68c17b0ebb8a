//! Counts what a thread asks of the allocator. The program installs [`Counting`], the loop watches its
//! own thread with it, and the last line of a run says what was counted.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::atomic::{AtomicBool, Ordering};

thread_local! {
    static WATCHED: Cell<bool> = const { Cell::new(false) };
    static CALLS: Cell<u64> = const { Cell::new(0) };
}

static INSTALLED: AtomicBool = AtomicBool::new(false);

/// The system's allocator, which counts its calls on watched threads. Every allocation, growth and
/// release is a call.
pub struct Counting;

fn note() {
    INSTALLED.store(true, Ordering::Relaxed);
    if WATCHED.get() {
        CALLS.set(CALLS.get() + 1);
    }
}

// SAFETY: every call is passed on unchanged to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        note();
        // SAFETY: the caller's promise is the one asked for here.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        note();
        // SAFETY: the caller's promise is the one asked for here.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        note();
        // SAFETY: the caller's promise is the one asked for here.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        note();
        // SAFETY: the caller's promise is the one asked for here.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

/// What `part` returns, and its calls to the allocator on this thread; `None` where [`Counting`] is not
/// the program's allocator.
pub fn watched<T>(part: impl FnOnce() -> T) -> (T, Option<u64>) {
    CALLS.set(0);
    WATCHED.set(true);
    let value = part();
    WATCHED.set(false);
    (value, INSTALLED.load(Ordering::Relaxed).then(|| CALLS.get()))
}
