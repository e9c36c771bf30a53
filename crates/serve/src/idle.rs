//! Connections that wait for a request: where there are too many, the one that has waited longest makes room.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// The connections of a service that wait for a complete head of a request.
#[derive(Default)]
pub(crate) struct IdleConnections(Mutex<State>);

#[derive(Default)]
struct State {
    /// By when they began to wait.
    waiting: BTreeMap<u64, Arc<Notify>>,
    next: u64,
    /// Whether somebody needs room and none was found.
    needed: bool,
}

impl IdleConnections {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Closes the connection that has waited longest, or else the next that begins to wait.
    pub(crate) fn make_room(&self) {
        let mut state = self.lock();
        match state.waiting.pop_first() {
            Some((_, close)) => close.notify_one(),
            None => state.needed = true,
        }
    }

    /// There is room: nobody has to close.
    pub(crate) fn has_room(&self) {
        self.lock().needed = false;
    }

    fn enter(&self, close: &Arc<Notify>) -> u64 {
        let mut state = self.lock();
        let number = state.next;
        state.next += 1;
        if std::mem::take(&mut state.needed) {
            close.notify_one();
        } else {
            state.waiting.insert(number, close.clone());
        }
        number
    }

    fn leave(&self, number: u64) {
        self.lock().waiting.remove(&number);
    }
}

/// A connection, which waits for a request except while it is [busy](Self::busy).
pub(crate) struct Client {
    idle: Arc<IdleConnections>,
    close: Arc<Notify>,
    number: AtomicU64,
}

/// A request that is being answered. Its connection waits for the next when this is dropped.
pub(crate) struct Busy(Arc<Client>);

impl Client {
    pub(crate) fn new(idle: &Arc<IdleConnections>) -> Arc<Self> {
        let (idle, close) = (idle.clone(), Arc::new(Notify::new()));
        let number = AtomicU64::new(idle.enter(&close));
        Arc::new(Self {
            idle,
            close,
            number,
        })
    }

    /// Returns once the connection has to make room.
    pub(crate) async fn closed(&self) {
        self.close.notified().await;
    }

    /// A request has come.
    pub(crate) fn busy(self: &Arc<Self>) -> Busy {
        self.idle.leave(self.number.load(Ordering::Relaxed));
        Busy(self.clone())
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        self.idle.leave(self.number.load(Ordering::Relaxed));
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        let number = self.0.idle.enter(&self.0.close);
        self.0.number.store(number, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures_util::FutureExt as _;

    fn is_closed(client: &Client) -> bool {
        client.closed().now_or_never().is_some()
    }

    #[test]
    fn the_one_that_waits_longest_makes_room() {
        let idle = Arc::new(IdleConnections::default());
        let clients = [(); 4].map(|()| Client::new(&idle));
        // The first has asked, and waits again; the second is being answered; the third has gone.
        drop(clients[0].busy());
        let answered = clients[1].busy();
        let [first, second, third, fourth] = clients;
        drop(third);
        idle.make_room();
        assert!(is_closed(&fourth) && !is_closed(&first) && !is_closed(&second));
        idle.make_room();
        assert!(is_closed(&first));
        // None is left but the one that is being answered: it closes after its answer.
        idle.make_room();
        assert!(!is_closed(&second));
        drop(answered);
        assert!(is_closed(&second));
        // No longer needed.
        let fifth = Client::new(&idle);
        idle.has_room();
        let busy = fifth.busy();
        idle.make_room();
        idle.has_room();
        drop(busy);
        assert!(!is_closed(&fifth));
    }
}
