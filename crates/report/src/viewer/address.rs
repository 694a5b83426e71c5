//! The address of a viewer.

use std::fmt;
use std::io;
use std::net::{TcpStream, ToSocketAddrs};
use std::str::FromStr;
use std::time::Duration;

/// Longest time that a viewer may take to accept a connection.
const CONNECT_PATIENCE: Duration = Duration::from_secs(1);

/// Host and port of a viewer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ViewerAddress(String);

impl ViewerAddress {
    /// Returns a port of this machine, which other machines cannot reach.
    pub fn loopback(port: u16) -> Self {
        Self(format!("127.0.0.1:{port}"))
    }

    /// Returns the address as the viewer itself writes it.
    pub fn url(&self) -> String {
        format!("rerun+http://{self}/proxy")
    }

    /// Checks whether a viewer listens at the address.
    ///
    /// # Errors
    /// No viewer listens there.
    pub fn answers(&self) -> Result<(), String> {
        let mut last = Err(io::Error::other("the host has no address"));
        let connected = self.0.to_socket_addrs().and_then(|sockets| {
            for socket in sockets {
                last = TcpStream::connect_timeout(&socket, CONNECT_PATIENCE);
                if last.is_ok() {
                    break;
                }
            }
            last
        });
        connected.map(drop).map_err(|error| {
            format!("no viewer answers at {self} ({error}); start one with: rerun --bind 127.0.0.1")
        })
    }
}

impl fmt::Display for ViewerAddress {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

impl FromStr for ViewerAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bare = text
            .strip_prefix("rerun+http://")
            .map_or(text, |rest| rest.strip_suffix("/proxy").unwrap_or(rest));
        if let Ok(port) = bare.parse() {
            return Ok(Self::loopback(port));
        }
        match bare.rsplit_once(':') {
            Some((host, port))
                if !host.is_empty() && !host.contains('/') && port.parse::<u16>().is_ok() =>
            {
                Ok(Self(bare.to_owned()))
            }
            _ => Err("expected PORT, HOST:PORT or rerun+http://HOST:PORT/proxy".to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_alone_is_of_this_machine() {
        let read = |text: &str| text.parse::<ViewerAddress>().map(|address| address.url());
        let local = Ok("rerun+http://127.0.0.1:9876/proxy".to_owned());
        assert_eq!(read("9876"), local);
        assert_eq!(read("127.0.0.1:9876"), local);
        assert_eq!(read("rerun+http://127.0.0.1:9876/proxy"), local);
        assert_eq!(read("[::1]:9"), Ok("rerun+http://[::1]:9/proxy".to_owned()));
        for wrong in ["", "bench", ":9876", "bench:", "http://bench:1/x", "99999"] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn an_address_without_a_viewer_is_refused_with_what_to_do() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = ViewerAddress::loopback(listener.local_addr().unwrap().port());
        assert_eq!(address.answers(), Ok(()));
        drop(listener);
        assert!(address.answers().unwrap_err().contains("start one with"));
    }
}
