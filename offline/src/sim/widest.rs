//! Plain loops on the widest registers that this processor has. Nothing is fused or reordered, so that the
//! numbers are the same on every processor.

/// Calls a function that is always inlined, compiled once for each kind of registers.
macro_rules! on_widest {
    ($function:ident($($name:ident: $type:ty),*) -> $result:ty) => {{
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx512f")]
        unsafe fn avx512($($name: $type),*) -> $result {
            $function($($name),*)
        }
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2")]
        unsafe fn avx2($($name: $type),*) -> $result {
            $function($($name),*)
        }
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx512f") {
            // SAFETY: the processor has the instructions that the function was compiled for.
            unsafe { avx512($($name),*) }
        } else if is_x86_feature_detected!("avx2") {
            // SAFETY: as above.
            unsafe { avx2($($name),*) }
        } else {
            $function($($name),*)
        }
        #[cfg(not(target_arch = "x86_64"))]
        $function($($name),*)
    }};
}

pub(super) use on_widest;
