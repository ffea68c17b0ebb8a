//! What the loop's thread asks of the operating system. Each wish may be refused; then the controller
//! runs without it and says so in every status.

use crate::constants::{BRIDGE_PRIORITY, FIFO_PRIORITY};
use shared::messages::degraded;
use std::fs::File;
use std::io::Write;

/// Asks for everything, for the calling thread, and returns the bits of what was refused.
pub fn prepare_thread() -> u32 {
    let mut refused = 0;
    if !lock_memory() {
        refused |= degraded::NO_MEMLOCK;
    }
    // The last processor permitted: the first ones serve most interrupts.
    if !processors().last().is_some_and(|&last| bind_to(&[last])) {
        refused |= degraded::NO_AFFINITY;
    }
    if !flush_denormals() {
        refused |= degraded::NO_FLUSH_TO_ZERO;
    }
    if !real_time_priority(FIFO_PRIORITY) {
        refused |= degraded::NO_FIFO;
    }
    refused
}

/// The names of the bits, for people.
pub fn describe(refused: u32) -> String {
    let names = [
        (degraded::NO_FIFO, "no real-time scheduling"),
        (degraded::NO_AFFINITY, "not bound to a processor"),
        (degraded::NO_MEMLOCK, "memory not locked"),
        (degraded::NO_FLUSH_TO_ZERO, "denormals not flushed"),
        (degraded::DRY_RUN, "dry run"),
        (degraded::MAY_SLEEP, "processors may sleep deeply"),
    ];
    let set: Vec<&str> = names
        .iter()
        .filter(|(bit, _)| refused & bit != 0)
        .map(|(_, name)| *name)
        .collect();
    if set.is_empty() {
        "nothing refused".to_string()
    } else {
        set.join(", ")
    }
}

/// Keeps every processor out of deep sleep for as long as what comes back is open (the kernel's
/// interface for quality of service: a latency of 0 µs, in binary); `None` when refused.
pub fn keep_processors_awake() -> Option<File> {
    let mut file = File::options().write(true).open("/dev/cpu_dma_latency").ok()?;
    file.write_all(&0i32.to_ne_bytes()).ok()?;
    Some(file)
}

/// Page faults of the calling thread so far.
pub fn page_faults() -> u64 {
    // SAFETY: the structure is plain numbers that the kernel fills.
    let usage = unsafe {
        let mut usage: libc::rusage = std::mem::zeroed();
        libc::getrusage(libc::RUSAGE_THREAD, &mut usage);
        usage
    };
    (usage.ru_minflt + usage.ru_majflt) as u64
}

/// Room for what is mapped after memory is locked: threads, the bridge, every client's samples.
const LATER_BYTES: usize = 256 << 20;

/// Also touches every page, so that no page fault is left for later. A limit that would make later mappings
/// fail counts as a refusal, for those would end the program: it then runs without the lock.
fn lock_memory() -> bool {
    let (private, no_access) = (libc::MAP_PRIVATE | libc::MAP_ANONYMOUS, libc::PROT_NONE);
    // SAFETY: locking changes how memory is backed, not what it holds; the mapping is new, never accessed and
    // removed at once.
    unsafe {
        if libc::mlockall(libc::MCL_CURRENT | libc::MCL_FUTURE) != 0 {
            return false;
        }
        let probe = libc::mmap(std::ptr::null_mut(), LATER_BYTES, no_access, private, -1, 0);
        if probe == libc::MAP_FAILED {
            libc::munlockall();
            return false;
        }
        libc::munmap(probe, LATER_BYTES);
    }
    true
}

/// The processors that the calling thread may run on, ascending.
pub fn processors() -> Vec<usize> {
    // SAFETY: the set is plain bits that the kernel fills; indices stay below its size.
    unsafe {
        let mut set: libc::cpu_set_t = std::mem::zeroed();
        if libc::sched_getaffinity(0, std::mem::size_of::<libc::cpu_set_t>(), &mut set) != 0 {
            return Vec::new();
        }
        (0..libc::CPU_SETSIZE as usize)
            .filter(|&cpu| libc::CPU_ISSET(cpu, &set))
            .collect()
    }
}

/// Binds the calling thread to these processors.
pub fn bind_to(cpus: &[usize]) -> bool {
    // SAFETY: the set is plain bits that the kernel reads; the indices come from `processors`.
    unsafe {
        let mut set: libc::cpu_set_t = std::mem::zeroed();
        for &cpu in cpus {
            libc::CPU_SET(cpu, &mut set);
        }
        libc::sched_setaffinity(0, std::mem::size_of::<libc::cpu_set_t>(), &set) == 0
    }
}

/// Lets the calling thread, the bridge, go before ordinary programs, so that a busy machine delays neither
/// goals nor emergency stops. What it starts later is ordinary. Where it is refused the loop is too, and
/// says so. It also leaves the loop's processor to the loop, where there is another: on a busy machine the
/// scheduler would put it just there, since the loop sleeps most of the time, and the loop would wake late.
pub fn prefer_bridge() -> bool {
    if let Some((_, others)) = processors().split_last().filter(|(_, others)| !others.is_empty()) {
        bind_to(others);
    }
    real_time_priority(BRIDGE_PRIORITY)
}

fn real_time_priority(sched_priority: i32) -> bool {
    let parameter = libc::sched_param { sched_priority };
    let policy = libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK;
    // SAFETY: the structure outlives the call; 0 is the calling thread.
    unsafe { libc::sched_setscheduler(0, policy, &parameter) == 0 }
}

/// Denormal operands cost a hundred cycles each; results and inputs below 1e-38 become zero instead.
#[cfg(target_arch = "x86_64")]
pub fn flush_denormals() -> bool {
    const FTZ_AND_DAZ: u32 = 1 << 15 | 1 << 6;
    let mut control = 0u32;
    // SAFETY: reads and writes this thread's control register of SSE arithmetic through valid memory.
    unsafe {
        std::arch::asm!("stmxcsr [{}]", in(reg) &mut control, options(nostack));
        control |= FTZ_AND_DAZ;
        std::arch::asm!("ldmxcsr [{}]", in(reg) &control, options(nostack));
    }
    true
}

/// Denormal operands cost a hundred cycles each; results and inputs below 1e-38 become zero instead.
#[cfg(target_arch = "aarch64")]
pub fn flush_denormals() -> bool {
    const FLUSH: u64 = 1 << 24;
    // SAFETY: reads and writes this thread's floating-point control register.
    unsafe {
        let mut control: u64;
        std::arch::asm!("mrs {}, fpcr", out(reg) control);
        control |= FLUSH;
        std::arch::asm!("msr fpcr, {}", in(reg) control);
    }
    true
}

/// Not known how on this processor.
#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
pub fn flush_denormals() -> bool {
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bit_has_a_name() {
        assert_eq!(describe(0), "nothing refused");
        assert_eq!(
            describe(degraded::NO_FIFO | degraded::DRY_RUN),
            "no real-time scheduling, dry run"
        );
    }
}
