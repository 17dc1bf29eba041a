//! Who holds places, and who loses one.

use super::*;
use std::net::Ipv4Addr;

fn places(connections: usize) -> Arc<Places> {
    let limits = Limits {
        connections,
        connections_per_peer: 4,
        connections_per_token: 6,
        streams: 3,
        streams_per_token: 2,
        bodies_bytes: 1000,
        window_bytes: 500,
        body_bytes: 500,
        ..Limits::default()
    };
    Places::new(limits)
}

fn peer(last: u8) -> IpAddr {
    Ipv4Addr::new(192, 0, 2, last).into()
}

/// A place whose connection has shown a token.
fn known(places: &Arc<Places>, from: u8, token: u8) -> Arc<Connection> {
    let place = places.take(peer(from), false);
    place.show([token; 32]);
    place
}

fn stands(place: &Connection) -> bool {
    let holder = *place.holder();
    let table = place.places.lock();
    let held = table.holders.get(&holder);
    held.is_some_and(|held| held.seats.iter().any(|seat| Arc::ptr_eq(seat, &place.seat)))
}

/// As if a connection had been heard so long after the beginning.
fn at(place: &Connection, milliseconds: u64) {
    place.seat.heard_at.store(milliseconds, Ordering::Relaxed);
}

#[test]
fn a_crowd_of_one_address_loses_its_own_places_and_the_quietest_first() {
    let places = places(100);
    let other = places.take(peer(9), false);
    let crowd: Vec<_> = (0..4).map(|_| places.take(peer(1), false)).collect();
    for (place, milliseconds) in crowd.iter().zip([7_000, 3_000, 9_000, 5_000]) {
        at(place, milliseconds);
    }
    let newest = places.take(peer(1), false);
    assert_eq!(crowd.iter().map(|place| stands(place)).collect::<Vec<_>>(), [true, false, true, true]);
    assert!(stands(&newest) && stands(&other));
    assert_eq!(places.crowd(), ConnectionCounts { connections: 5, strangers: 5, streams: 0, displaced: 1 });
    drop((crowd, newest, other));
    assert_eq!(places.crowd().connections, 0);
    assert!(places.lock().holders.is_empty());
}

#[test]
fn strangers_from_everywhere_leave_most_of_the_places_to_those_with_a_token() {
    let places = places(40);
    let strangers: Vec<_> = (0..30)
        .map(|from| {
            let place = places.take(peer(from), false);
            at(&place, u64::from(from));
            place
        })
        .collect();
    assert_eq!(places.crowd().connections, 10);
    assert!(strangers[20..].iter().all(|place| stands(place)), "the quietest go first");
    let trusted: Vec<_> = (0..38).map(|number| known(&places, 200, number / 5)).collect();
    assert!(trusted.iter().all(|place| stands(place)));
    assert_eq!(places.crowd().connections, 40);
    assert_eq!(strangers.iter().filter(|place| stands(place)).count(), 2);
    // Where there are no strangers left, whoever holds most loses one.
    let more: Vec<_> = (0..3).map(|from| places.take(peer(from), false)).collect();
    assert_eq!(places.crowd().connections, 40);
    assert!(stands(&more[2]));
}

#[test]
fn whoever_has_just_come_may_speak_before_the_place_is_lost() {
    let places = places(16);
    let peers: Vec<_> = (0..4).map(|from| places.take(peer(from), false)).collect();
    let soon = places.milliseconds() + 1_000;
    peers.iter().for_each(|place| at(place, soon));
    let pause = places.pause(peer(9), false).as_millis() as u64;
    assert!((1_000..=1_000 + MOMENT).contains(&pause), "{pause} ms");
    // One of them has been quiet for long enough.
    at(&peers[2], 0);
    std::thread::sleep(Duration::from_millis(MOMENT));
    assert_eq!(places.pause(peer(9), false), Duration::ZERO);
    // A crowd from one address waits for nobody but itself.
    let places = self::places(100);
    let crowd: Vec<_> = (0..4).map(|_| places.take(peer(7), false)).collect();
    crowd.iter().for_each(|place| at(place, soon));
    assert_eq!(places.pause(peer(7), false), Duration::ZERO);
}

#[test]
fn a_token_has_a_cap_and_takes_no_place_from_another() {
    let places = places(100);
    let controller = known(&places, 1, 1);
    let flood: Vec<_> = (0..50).map(|_| known(&places, 1, 2)).collect();
    assert!(stands(&controller));
    assert_eq!(flood.iter().filter(|place| stands(place)).count(), 6);
    // A connection that has lost its place gets none by showing another token.
    flood[0].show([3; 32]);
    assert!(!stands(&flood[0]));
    assert_eq!(places.crowd().connections, 7);
}

#[test]
fn bodies_are_counted_by_token_and_in_all() {
    let places = places(100);
    let body = |token: u8| known(&places, token, token).body();
    let (mut one, mut same, mut two, mut three) = (body(1), body(1), body(2), body(3));
    assert!(one.grow(300) && one.grow(100) && !same.grow(101), "a token has half of all");
    assert!(same.grow(100) && two.grow(400) && !three.grow(101) && three.grow(100), "all have 1000");
    drop(one);
    assert!(three.grow(400) && !three.grow(1));
    drop((same, two, three));
    assert!(places.lock().holders.is_empty() && places.lock().bytes == 0);
}

#[test]
fn streams_are_counted_by_token_and_in_all() {
    let places = places(100);
    let stream = |token: u8| known(&places, token, token).stream();
    let mut open = vec![stream(1).unwrap(), stream(1).unwrap()];
    assert!(stream(1).is_none(), "a token has two");
    open.push(stream(2).unwrap());
    assert!(stream(3).is_none(), "there are three in all");
    open.clear();
    assert_eq!(places.crowd(), ConnectionCounts { connections: 0, strangers: 0, streams: 0, displaced: 0 });
    assert!(stream(3).is_some());
}
