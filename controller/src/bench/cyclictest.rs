//! Runs cyclictest (package rt-tests) the way the loop runs: same processor, priority, period, locked
//! memory and kind of sleep.

use crate::constants::FIFO_PRIORITY;
use crate::rt;
use crate::timing::histogram;
use hdrhistogram::Histogram;
use std::process::Command;
use std::time::Duration;

/// Longest latency that cyclictest tells apart, µs.
const LONGEST_US: u32 = 200_000;

/// How late cyclictest woke, ns; or why it could not be asked.
pub fn run(period_ns: u64, duration: Duration) -> Result<Histogram<u64>, String> {
    let cpu = rt::processors().last().copied().unwrap_or(0);
    let output = Command::new("cyclictest")
        .args(["--quiet", "--mlockall", "--threads=1"])
        .arg(format!("--priority={FIFO_PRIORITY}"))
        .arg(format!("--affinity={cpu}"))
        .arg(format!("--interval={}", period_ns / 1000))
        .arg(format!("--duration={}", duration.as_secs().max(1)))
        .arg(format!("--histogram={LONGEST_US}"))
        .output()
        .map_err(|_| "cyclictest is not on the PATH: install rt-tests to compare with it".to_string())?;
    if !output.status.success() {
        let text = String::from_utf8_lossy(&output.stderr);
        let line = text.lines().next().unwrap_or_default().to_string();
        return Err(format!("cyclictest failed: {line}"));
    }
    read(&String::from_utf8_lossy(&output.stdout))
        .ok_or_else(|| "cyclictest printed no histogram".to_string())
}

/// The histogram in cyclictest's output: lines of a latency in whole µs and a count, and the overflows.
fn read(text: &str) -> Option<Histogram<u64>> {
    let mut times = histogram();
    for line in text.lines() {
        if let Some(cycles) = line.strip_prefix("# Histogram Overflows:") {
            let count: u64 = cycles.split_whitespace().next()?.parse().ok()?;
            if count > 0 {
                times.saturating_record_n(u64::from(LONGEST_US) * 1000, count);
            }
            continue;
        }
        let mut words = line.split_whitespace().map(str::parse::<u64>);
        if let (Some(Ok(us)), Some(Ok(count)), None) = (words.next(), words.next(), words.next())
            && count > 0
        {
            // The middle of the microsecond that cyclictest cut off.
            times.saturating_record_n(us * 1000 + 500, count);
        }
    }
    (!times.is_empty()).then_some(times)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_histogram_is_read_and_the_rest_passed_over() {
        let text = "# /dev/cpu_dma_latency set to 0us\n# Histogram\n000000 000000\n000017 000098\n\
                    000040 000002\n# Total: 000000100\n# Min Latencies: 00017\n\
                    # Histogram Overflows: 00000\n# Histogram Overflow at cycle number:\n# Thread 0:\n";
        let times = read(text).expect("a histogram");
        assert_eq!(times.len(), 100);
        assert!(times.max() < 50_000);
        let near = |quantile, us: f64| (times.value_at_quantile(quantile) as f64 * 1e-3 - us).abs() < 0.1;
        assert!(near(0.5, 17.5) && near(0.99, 40.5), "{}", times.max());
        assert!(read("nothing here").is_none());
    }
}
