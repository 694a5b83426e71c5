//! The address of a viewer.

use std::fmt;
use std::net::{SocketAddr, TcpStream, ToSocketAddrs};
use std::str::FromStr;
use std::time::Duration;

/// Longest time that a viewer may take to accept a connection.
const CONNECT_PATIENCE: Duration = Duration::from_secs(1);

/// Host and port of a viewer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ViewerAddress {
    host: String,
    port: u16,
}

impl ViewerAddress {
    /// Returns a port of this machine, which other machines cannot reach.
    pub fn loopback(port: u16) -> Self {
        Self {
            host: "127.0.0.1".to_owned(),
            port,
        }
    }

    /// Returns the port.
    pub fn port(&self) -> u16 {
        self.port
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
        let connected = self.sockets().and_then(|sockets| {
            let mut last = Err(format!("{} has no address", self.host));
            for socket in sockets {
                last = TcpStream::connect_timeout(&socket, CONNECT_PATIENCE)
                    .map_err(|error| error.to_string());
                if last.is_ok() {
                    break;
                }
            }
            last
        });
        connected.map(|_| ()).map_err(|error| {
            format!("no viewer answers at {self} ({error}); start one with: rerun --bind 127.0.0.1")
        })
    }

    fn sockets(&self) -> Result<impl Iterator<Item = SocketAddr>, String> {
        let host = self.host.trim_matches(['[', ']']);
        (host, self.port)
            .to_socket_addrs()
            .map_err(|error| error.to_string())
    }
}

impl fmt::Display for ViewerAddress {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}:{}", self.host, self.port)
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
        let parts = bare
            .rsplit_once(':')
            .and_then(|(host, port)| Some((host, port.parse().ok()?)));
        match parts {
            Some((host, port)) if !host.is_empty() && !host.contains('/') => Ok(Self {
                host: host.to_owned(),
                port,
            }),
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
