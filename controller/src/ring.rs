//! A queue between two threads that neither of them can hold up.

use crossbeam::queue::ArrayQueue;
use crossbeam::utils::CachePadded;
use std::sync::atomic::{AtomicU64, Ordering};

/// A queue of fixed capacity from one thread to one other.
///
/// [`ArrayQueue`] alone waits: what finds the other side in the middle of putting in or taking out spins until that is
/// done. Where the loop took the processor from the bridge there, both stood still for ever (seen with both on one
/// processor and a flood of messages at 333 Hz). Here each side counts what it has done with, and touches only what the
/// other has counted, so its one attempt succeeds. With more than two threads items could wait longer, or get lost, but
/// never be damaged.
pub struct Ring<T> {
    queue: ArrayQueue<T>,
    /// Items put in so far; written by the one side.
    put: CachePadded<AtomicU64>,
    /// Items taken out so far; written by the other.
    taken: CachePadded<AtomicU64>,
}

impl<T> Ring<T> {
    /// An empty queue; the only allocation.
    pub fn new(capacity: usize) -> Self {
        Self {
            queue: ArrayQueue::new(capacity),
            put: CachePadded::new(AtomicU64::new(0)),
            taken: CachePadded::new(AtomicU64::new(0)),
        }
    }

    /// Puts an item in; gives it back where there is no room.
    ///
    /// # Errors
    /// There is no room.
    pub fn push(&self, item: T) -> Result<(), T> {
        let put = self.put.load(Ordering::Relaxed);
        if put - self.taken.load(Ordering::Acquire) >= self.queue.capacity() as u64 {
            return Err(item);
        }
        self.queue.push(item)?;
        self.put.store(put + 1, Ordering::Release);
        Ok(())
    }

    /// Takes the oldest item out.
    pub fn pop(&self) -> Option<T> {
        let taken = self.taken.load(Ordering::Relaxed);
        if self.put.load(Ordering::Acquire) == taken {
            return None;
        }
        let item = self.queue.pop()?;
        self.taken.store(taken + 1, Ordering::Release);
        Some(item)
    }

    /// Takes out what is in it now, oldest first; what comes meanwhile waits, however fast it comes.
    pub fn drain(&self) -> impl Iterator<Item = T> + '_ {
        let waiting = self.put.load(Ordering::Acquire) - self.taken.load(Ordering::Relaxed);
        (0..waiting).map_while(|_| self.pop())
    }

    /// Whether nothing waits in it.
    pub fn is_empty(&self) -> bool {
        self.put.load(Ordering::Acquire) == self.taken.load(Ordering::Acquire)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn items_come_out_as_they_went_in_and_what_has_no_room_comes_back() {
        let ring = Ring::new(3);
        assert_eq!((ring.pop(), ring.is_empty()), (None, true));
        for round in 0..10 {
            let items = [round, round + 1, round + 2];
            assert!(items.iter().all(|&item| ring.push(item).is_ok()));
            assert_eq!(ring.push(99), Err(99));
            assert_eq!(ring.drain().collect::<Vec<_>>(), items);
        }
    }

    /// The other side was stopped before it had counted: it is as if it had not begun.
    #[test]
    fn what_the_other_side_has_not_done_with_does_not_hold_this_one_up() {
        let ring = Ring::new(2);
        ring.queue.push(1).unwrap();
        assert_eq!((ring.pop(), ring.drain().count()), (None, 0));
        let ring = Ring::new(1);
        ring.push(1).unwrap();
        assert_eq!(ring.queue.pop(), Some(1));
        assert_eq!(ring.push(2), Err(2), "its place is not free before it is counted");
    }

    #[test]
    fn two_threads_pass_everything_on_in_order() {
        const ITEMS: u64 = 200_000;
        let ring = Ring::new(16);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                for mut item in 0..ITEMS {
                    while let Err(back) = ring.push(item) {
                        item = back;
                        std::thread::yield_now();
                    }
                }
            });
            let mut next = 0;
            while next < ITEMS {
                for item in ring.drain() {
                    assert_eq!(item, next);
                    next += 1;
                }
                std::thread::yield_now();
            }
        });
        assert!(ring.is_empty());
    }

    /// While one is taken out another comes in: it waits for the next time.
    #[test]
    fn draining_ends_however_fast_items_come() {
        let ring = Ring::new(4);
        ring.push(1).unwrap();
        let drained = ring.drain().inspect(|_| ring.push(2).unwrap());
        assert_eq!(drained.collect::<Vec<_>>(), [1]);
        assert_eq!(ring.pop(), Some(2));
    }
}
