//! A network between a process and a test's server that can be cut: then nothing passes, and nobody is told. It can be
//! slow, too.

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// How often a silent connection looks whether the wire was cut, mended or taken away.
const LOOK: Duration = Duration::from_millis(20);

#[derive(Default)]
struct State {
    is_cut: AtomicBool,
    is_gone: AtomicBool,
    /// How many bytes pass in a second each way, over all connections; 0: as many as come.
    bytes_per_second: AtomicU64,
}

/// A port of this machine that leads to another one. It ends with its test.
pub struct Wire {
    pub port: u16,
    state: Arc<State>,
    listening: Option<JoinHandle<()>>,
}

impl Wire {
    /// A wire to a port.
    pub fn to(port: u16) -> Self {
        let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
        listener.set_nonblocking(true).unwrap();
        let state = Arc::new(State::default());
        Self {
            port: listener.local_addr().unwrap().port(),
            listening: Some(std::thread::spawn({
                let state = state.clone();
                move || listen(&listener, port, &state)
            })),
            state,
        }
    }

    /// Lets no more than so many bytes pass in a second.
    pub fn slow_down(&self, bytes_per_second: u64) {
        let rate = &self.state.bytes_per_second;
        rate.store(bytes_per_second, Ordering::SeqCst);
    }

    /// Lets nothing pass.
    pub fn cut(&self) {
        self.state.is_cut.store(true, Ordering::SeqCst);
    }

    /// Lets all pass again, also what came meanwhile.
    pub fn mend(&self) {
        self.state.is_cut.store(false, Ordering::SeqCst);
    }
}

impl Drop for Wire {
    fn drop(&mut self) {
        self.state.is_gone.store(true, Ordering::SeqCst);
        if let Some(listening) = self.listening.take() {
            let _ = listening.join();
        }
    }
}

/// Carries connections until the wire is gone.
fn listen(listener: &TcpListener, port: u16, state: &Arc<State>) {
    let mut carrying = Vec::new();
    while !state.is_gone.load(Ordering::SeqCst) {
        let Ok((near, _)) = listener.accept() else {
            std::thread::sleep(LOOK);
            continue;
        };
        let Ok(far) = TcpStream::connect(("127.0.0.1", port)) else {
            continue;
        };
        for (from, to) in [(&near, &far), (&far, &near)] {
            let (from, to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
            let state = state.clone();
            carrying.push(std::thread::spawn(move || carry(from, to, &state)));
        }
    }
    for carrier in carrying {
        let _ = carrier.join();
    }
}

/// Passes on what comes, until one end closes or the wire is gone.
fn carry(mut from: TcpStream, mut to: TcpStream, state: &State) {
    from.set_nonblocking(false).unwrap();
    from.set_read_timeout(Some(LOOK)).unwrap();
    to.set_write_timeout(Some(Duration::from_secs(1))).unwrap();
    let mut bytes = vec![0; 64 << 10];
    while !state.is_gone.load(Ordering::SeqCst) {
        let read = match from.read(&mut bytes) {
            Ok(0) => break,
            Ok(read) => read,
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                continue;
            }
            Err(_) => break,
        };
        while state.is_cut.load(Ordering::SeqCst) && !state.is_gone.load(Ordering::SeqCst) {
            std::thread::sleep(LOOK);
        }
        let rate = state.bytes_per_second.load(Ordering::SeqCst);
        if rate > 0 {
            let time = read as f64 / rate as f64;
            std::thread::sleep(Duration::from_secs_f64(time));
        }
        if to.write_all(&bytes[..read]).is_err() {
            break;
        }
    }
    let _ = to.shutdown(std::net::Shutdown::Both);
    let _ = from.shutdown(std::net::Shutdown::Both);
}
