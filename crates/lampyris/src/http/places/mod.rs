//! Who holds how many connections, and who loses one where there are too many.
//!
//! A connection is charged to the network that it comes from until it shows a token that is good; from then
//! on to the token. Nobody waits in line: where all places are taken, whoever comes gets one, and of those
//! that hold most somebody who has been quiet for long loses one. Only where all of those have come this
//! moment is the next one kept waiting for the rest of it (`pause`). Strangers hold a part of the places
//! only, so that the rest is there for those with a token.

use crate::service::access::tokens::network;
use crate::settings::Limits;
use std::cmp::Reverse;
use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::Notify;

/// How long after it came, or was last heard, a connection keeps its place before it is anybody's, in
/// milliseconds: much longer than a client takes between its connection and its request, and short enough
/// that a flood is accepted as fast as it comes.
const MOMENT: u64 = 20;

/// All places of a listener.
#[derive(Debug)]
pub struct Places {
    limits: Limits,
    began: Instant,
    table: Mutex<Table>,
}

/// Who is charged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Holder {
    /// A network that has shown no token.
    Stranger(IpAddr),
    /// A token, by its hash.
    Token([u8; 32]),
    /// Everybody, where there are no tokens.
    Local,
}

#[derive(Debug, Default)]
struct Table {
    holders: HashMap<Holder, Held>,
    all: usize,
    strangers: usize,
    streams: usize,
    /// Bytes of bodies that are read or worked on.
    bytes: usize,
    displaced: u64,
}

#[derive(Debug, Default)]
struct Held {
    seats: Vec<Arc<Seat>>,
    streams: usize,
    bytes: usize,
}

/// What a connection tells of itself.
#[derive(Debug, Default)]
pub struct Seat {
    /// When it has last said or taken something, in milliseconds since the listener began.
    heard_at: AtomicU64,
    is_lost: AtomicBool,
    lost: Notify,
}

/// The place of one connection, until it is dropped.
#[derive(Debug)]
pub struct Connection {
    places: Arc<Places>,
    peer: IpAddr,
    seat: Arc<Seat>,
    holder: Mutex<Holder>,
}

/// A stream of events that a connection carries, until it is dropped.
#[derive(Debug)]
pub struct StreamPlace {
    place: Arc<Connection>,
    holder: Holder,
}

/// What a body takes of the room for all bodies, until it is dropped.
#[derive(Debug)]
pub struct BodyPlace {
    place: Arc<Connection>,
    holder: Holder,
    bytes: usize,
}

/// What is counted of all places.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ConnectionCounts {
    /// Connections that are open.
    pub connections: usize,
    /// Those of them that have shown no token.
    pub strangers: usize,
    /// Streams of events that are open.
    pub streams: usize,
    /// Connections that lost their place to others, ever.
    pub displaced: u64,
}

impl Places {
    /// The places that the limits allow.
    pub fn new(limits: Limits) -> Arc<Self> {
        Arc::new(Self { limits, began: Instant::now(), table: Mutex::default() })
    }

    /// A place for a connection that has just come. Where there are no tokens (`is_open`) nobody is a
    /// stranger.
    pub fn take(self: &Arc<Self>, peer: IpAddr, is_open: bool) -> Arc<Connection> {
        let holder = Holder::of(peer, is_open);
        let seat = Arc::new(Seat { heard_at: AtomicU64::new(self.milliseconds()), ..Seat::default() });
        let mut table = self.lock();
        self.make_room(&mut table, holder);
        table.add(holder, seat.clone());
        drop(table);
        Arc::new(Connection { places: self.clone(), peer, seat, holder: Mutex::new(holder) })
    }

    fn crowd(&self) -> ConnectionCounts {
        let Table { all, strangers, streams, displaced, .. } = *self.lock();
        ConnectionCounts { connections: all, strangers, streams, displaced }
    }

    /// How long to wait before whoever comes gets a place. Where all places of strangers are taken by those
    /// who have come this moment, the quietest of them has time to speak first: or else a flood from many
    /// addresses would throw out a client that is about to show its token.
    pub fn pause(&self, peer: IpAddr, is_open: bool) -> Duration {
        let holder = Holder::of(peer, is_open);
        let table = self.lock();
        let heard_at = match self.loser(&table, holder) {
            // A crowd keeps nobody waiting but itself.
            Some(loser) if loser != holder => table.quietest(loser).map(|seat| seat.heard_at()),
            _ => None,
        };
        let speaks_until = heard_at.map_or(0, |heard_at| heard_at + MOMENT);
        Duration::from_millis(speaks_until.saturating_sub(self.milliseconds()))
    }

    /// Frees a place for one more connection of a holder, where all that it may have are taken.
    fn make_room(&self, table: &mut Table, holder: Holder) {
        if let Some(loser) = self.loser(table, holder) {
            table.displace(loser);
        }
    }

    /// Who loses a place where a holder gets one more.
    fn loser(&self, table: &Table, holder: Holder) -> Option<Holder> {
        let now = self.milliseconds();
        let held = table.holders.get(&holder).map_or(0, |held| held.seats.len());
        if held >= self.most(holder) {
            Some(holder)
        } else if matches!(holder, Holder::Stranger(_)) && table.strangers >= self.most_strangers() {
            table.largest(true, now)
        } else if table.all >= self.limits.connections {
            table.largest(true, now).or_else(|| table.largest(false, now))
        } else {
            None
        }
    }

    fn most(&self, holder: Holder) -> usize {
        match holder {
            Holder::Stranger(_) => self.limits.connections_per_peer,
            Holder::Token(_) => self.limits.connections_per_token,
            Holder::Local => self.limits.connections,
        }
    }

    /// A quarter of all places: the others are for those with a token.
    fn most_strangers(&self) -> usize {
        self.limits.connections / 4
    }

    fn milliseconds(&self) -> u64 {
        u64::try_from(self.began.elapsed().as_millis()).unwrap_or(u64::MAX)
    }

    fn lock(&self) -> MutexGuard<'_, Table> {
        // A panic while the lock was held can at most have lost a count.
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Holder {
    /// Whom a connection is charged to that has just come.
    fn of(peer: IpAddr, is_open: bool) -> Self {
        if is_open { Self::Local } else { Self::Stranger(network(peer)) }
    }
}

impl Seat {
    fn heard_at(&self) -> u64 {
        self.heard_at.load(Ordering::Relaxed)
    }
}

impl Table {
    fn add(&mut self, holder: Holder, seat: Arc<Seat>) {
        self.holders.entry(holder).or_default().seats.push(seat);
        self.all += 1;
        self.strangers += usize::from(matches!(holder, Holder::Stranger(_)));
    }

    /// Takes a seat out; `false` where it was lost before.
    fn remove(&mut self, holder: Holder, seat: &Arc<Seat>) -> bool {
        let Some(held) = self.holders.get_mut(&holder) else { return false };
        let Some(at) = held.seats.iter().position(|one| Arc::ptr_eq(one, seat)) else { return false };
        held.seats.swap_remove(at);
        self.all -= 1;
        self.strangers -= usize::from(matches!(holder, Holder::Stranger(_)));
        self.forget(holder);
        true
    }

    /// Forgets a holder of nothing.
    fn forget(&mut self, holder: Holder) {
        let is_idle = |held: &Held| held.seats.is_empty() && held.streams == 0 && held.bytes == 0;
        if self.holders.get(&holder).is_some_and(is_idle) {
            self.holders.remove(&holder);
        }
    }

    /// Whoever holds most, of strangers or of all, and has a connection that had its moment by `now`; of
    /// several, the one of the connection that has been quiet longest.
    fn largest(&self, only_strangers: bool, now: u64) -> Option<Holder> {
        let asked = self
            .holders
            .iter()
            .filter(|(holder, _)| !only_strangers || matches!(holder, Holder::Stranger(_)));
        let rank = |held: &Held| {
            let quietest = held.seats.iter().map(|seat| seat.heard_at()).min()?;
            Some((quietest + MOMENT <= now, held.seats.len(), Reverse(quietest)))
        };
        let ranked = asked.filter_map(|(holder, held)| Some((*holder, rank(held)?)));
        ranked.max_by_key(|(_, rank)| *rank).map(|(holder, _)| holder)
    }

    /// The seat of a holder that has been quiet longest.
    fn quietest(&self, holder: Holder) -> Option<&Arc<Seat>> {
        self.holders.get(&holder)?.seats.iter().min_by_key(|seat| seat.heard_at())
    }

    /// Takes the place of the connection of a holder that has been quiet longest.
    fn displace(&mut self, holder: Holder) {
        if let Some(seat) = self.quietest(holder).cloned() {
            self.remove(holder, &seat);
            self.displaced += 1;
            seat.is_lost.store(true, Ordering::Relaxed);
            seat.lost.notify_one();
        }
    }
}

impl Connection {
    /// The address that it came from.
    pub fn peer(&self) -> IpAddr {
        self.peer
    }

    /// What is counted of all places now.
    pub fn crowd(&self) -> ConnectionCounts {
        self.places.crowd()
    }

    /// The connection has said or taken something.
    pub fn heard(&self) {
        self.seat.heard_at.store(self.places.milliseconds(), Ordering::Relaxed);
    }

    /// Whether somebody else was given the place.
    pub fn is_lost(&self) -> bool {
        self.seat.is_lost.load(Ordering::Relaxed)
    }

    /// Waits until somebody else was given the place.
    pub async fn lost(&self) {
        self.seat.lost.notified().await;
    }

    /// Charges it to a token that is good, by the hash of the token.
    pub fn show(&self, token: [u8; 32]) {
        let mut holder = self.holder();
        if *holder == Holder::Token(token) {
            return;
        }
        let mut table = self.places.lock();
        if table.remove(*holder, &self.seat) {
            *holder = Holder::Token(token);
            self.places.make_room(&mut table, *holder);
            table.add(*holder, self.seat.clone());
        }
    }

    /// A stream of events for this connection, `None` where its holder has, or all together have, as many as
    /// they may.
    pub fn stream(self: Arc<Self>) -> Option<StreamPlace> {
        let holder = *self.holder();
        let limits = &self.places.limits;
        let most = if holder == Holder::Local { limits.streams } else { limits.streams_per_token };
        let mut table = self.places.lock();
        let held = table.holders.get(&holder).map_or(0, |held| held.streams);
        if held >= most || table.streams >= limits.streams {
            return None;
        }
        table.streams += 1;
        table.holders.entry(holder).or_default().streams += 1;
        drop(table);
        Some(StreamPlace { place: self, holder })
    }

    /// Room for the body of a request of this connection, which grows as it comes.
    pub fn body(self: Arc<Self>) -> BodyPlace {
        let holder = *self.holder();
        BodyPlace { place: self, holder, bytes: 0 }
    }

    fn holder(&self) -> MutexGuard<'_, Holder> {
        self.holder.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl BodyPlace {
    /// Takes room for so many bytes more; `false` where there is none, or where its holder would have more
    /// than half of all.
    pub fn grow(&mut self, bytes: usize) -> bool {
        let places = &self.place.places;
        let mut table = places.lock();
        let most = places.limits.all_bodies();
        let held = table.holders.get(&self.holder).map_or(0, |held| held.bytes);
        if table.bytes + bytes > most || (self.holder != Holder::Local && held + bytes > most / 2) {
            return false;
        }
        table.bytes += bytes;
        table.holders.entry(self.holder).or_default().bytes += bytes;
        self.bytes += bytes;
        true
    }
}

impl Drop for BodyPlace {
    fn drop(&mut self) {
        let mut table = self.place.places.lock();
        table.bytes -= self.bytes;
        if let Some(held) = table.holders.get_mut(&self.holder) {
            held.bytes -= self.bytes;
        }
        table.forget(self.holder);
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        let holder = *self.holder();
        self.places.lock().remove(holder, &self.seat);
    }
}

impl Drop for StreamPlace {
    fn drop(&mut self) {
        let mut table = self.place.places.lock();
        table.streams -= 1;
        if let Some(held) = table.holders.get_mut(&self.holder) {
            held.streams -= 1;
        }
        table.forget(self.holder);
    }
}

#[cfg(test)]
mod tests;
