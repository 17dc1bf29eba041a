//! A way to the database that can be cut, so that what is sent is held back and nobody is told, or lead to
//! another one.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{sleep, spawn};
use std::time::Duration;

/// A proxy in front of a server.
pub struct Way {
    /// Where it listens.
    pub port: u16,
    is_cut: Arc<AtomicBool>,
    server: Arc<Mutex<String>>,
}

impl Way {
    /// To `host:port`.
    pub fn to(server: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let is_cut = Arc::new(AtomicBool::new(false));
        let server = Arc::new(Mutex::new(server.to_owned()));
        let (leads_to, cut) = (server.clone(), is_cut.clone());
        spawn(move || {
            for near in listener.incoming().map_while(Result::ok) {
                let server = leads_to.lock().unwrap().clone();
                let Ok(far) = TcpStream::connect(server) else { continue };
                for (from, to) in [(&near, &far), (&far, &near)] {
                    let (from, to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
                    let cut = cut.clone();
                    spawn(move || carry(from, to, &cut));
                }
            }
        });
        Self { port, is_cut, server }
    }

    /// Leads whoever comes from now on to another server.
    pub fn lead_to(&self, server: &str) {
        *self.server.lock().unwrap() = server.to_owned();
    }

    /// Cuts it, or joins it again.
    pub fn cut(&self, is_cut: bool) {
        self.is_cut.store(is_cut, Ordering::Relaxed);
    }
}

fn carry(mut from: TcpStream, mut to: TcpStream, is_cut: &AtomicBool) {
    let mut bytes = [0; 1 << 16];
    while let Ok(count @ 1..) = from.read(&mut bytes) {
        while is_cut.load(Ordering::Relaxed) {
            sleep(Duration::from_millis(10));
        }
        if to.write_all(&bytes[..count]).is_err() {
            break;
        }
    }
    let _ = to.shutdown(Shutdown::Both);
}
