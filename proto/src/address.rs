//! Properties of a server that follow from its URL alone.

use core::net::IpAddr;

/// Whether a URL names this very machine: a proxy set for the outside world must not come between.
///
/// Text only, nothing is looked up: `localhost` and addresses of the loopback network count, other names do not.
pub fn is_loopback(url: &str) -> bool {
    let host = host_of(url);
    let bare = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host);
    host.eq_ignore_ascii_case("localhost") || bare.parse().is_ok_and(|address: IpAddr| address.is_loopback())
}

/// The host in `scheme://user:password@host:port/path`; an IPv6 address keeps its brackets.
fn host_of(url: &str) -> &str {
    let rest = url.split_once("://").map_or(url, |(_, rest)| rest);
    let authority = rest.split(['/', '?', '#']).next().unwrap_or(rest);
    let host_and_port = authority.rsplit_once('@').map_or(authority, |(_, rest)| rest);
    match host_and_port.find(']') {
        Some(end) => &host_and_port[..=end],
        None => host_and_port.split(':').next().unwrap_or(host_and_port),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_this_machines_own_addresses_are_loopback() {
        let own = [
            "http://localhost:7410",
            "http://LOCALHOST",
            "http://127.0.0.1:7410/v1",
            "http://127.8.9.1",
            "https://[::1]:7410",
            "http://me:secret@127.0.0.1:1?x",
            "127.0.0.1:7410",
        ];
        for url in own {
            assert!(is_loopback(url), "{url}");
        }
        let foreign = [
            "http://127.evil.example",
            "http://localhost.evil.example:7410",
            "http://127.0.0.1@evil.example",
            "http://evil.example/127.0.0.1",
            "http://evil.example?@127.0.0.1",
            "http://10.0.0.1",
            "http://[::2]",
            "http://[::1",
            "",
        ];
        for url in foreign {
            assert!(!is_loopback(url), "{url}");
        }
    }
}
