//! Addresses that webhooks may call.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};

use reqwest::Url;
use url::Host;

/// A URL to post to, or its fault. A name is looked up, and checked again, for each delivery.
pub(super) fn checked(text: &str, allow_local: bool) -> Result<Url, String> {
    let url: Url = text.parse().map_err(|error| format!("'{text}' is no URL: {error}"))?;
    if !matches!(url.scheme(), "http" | "https") {
        return Err(format!("'{text}' is neither http:// nor https://"));
    }
    let literal = match url.host() {
        Some(Host::Ipv4(address)) => Some(IpAddr::V4(address)),
        Some(Host::Ipv6(address)) => Some(IpAddr::V6(address)),
        Some(Host::Domain(_)) => None,
        None => return Err(format!("'{text}' names no host")),
    };
    match literal {
        Some(address) if !allow_local && is_local(address) => Err(format!(
            "'{text}' is this machine or its link, which webhooks do not call; --webhook-allow-local lets them"
        )),
        _ => Ok(url),
    }
}

/// Addresses of a URL's host at this moment, all of which may be called.
pub(super) async fn resolve(url: &Url, allow_local: bool) -> Result<Vec<SocketAddr>, String> {
    let port = url.port_or_known_default().unwrap_or(443);
    let host = match url.host() {
        Some(Host::Ipv4(address)) => address.to_string(),
        Some(Host::Ipv6(address)) => address.to_string(),
        Some(Host::Domain(name)) => name.to_owned(),
        None => return Err("the URL names no host".to_owned()),
    };
    let found = tokio::net::lookup_host((host.as_str(), port)).await;
    let found: Vec<SocketAddr> = found.map_err(|error| format!("{host} is not found: {error}"))?.collect();
    // All of them: a name that is both here and elsewhere is not to be trusted.
    match found.iter().find(|address| !allow_local && is_local(address.ip())) {
        Some(address) => Err(format!("{host} is {}, this machine or its link", address.ip())),
        None if found.is_empty() => Err(format!("{host} has no address")),
        None => Ok(found),
    }
}

/// This machine, its link, or nobody in particular.
fn is_local(address: IpAddr) -> bool {
    match address {
        IpAddr::V4(address) => is_local_v4(address),
        IpAddr::V6(address) => match within(address) {
            Some(address) => is_local_v4(address),
            None => {
                let is_link_local = address.segments()[0] & 0xffc0 == 0xfe80;
                address.is_loopback() || address.is_unspecified() || address.is_multicast() || is_link_local
            }
        },
    }
}

fn is_local_v4(address: Ipv4Addr) -> bool {
    let is_this_network = address.octets()[0] == 0;
    address.is_loopback()
        || address.is_link_local()
        || address.is_multicast()
        || address.is_broadcast()
        || is_this_network
}

/// The IPv4 address that an IPv6 address stands for: mapped, compatible, translated (64:ff9b::/96) or 6to4.
fn within(address: Ipv6Addr) -> Option<Ipv4Addr> {
    let [a, b, c, d, e, f, g, h] = address.segments();
    let v4 = |high: u16, low: u16| {
        let [a, b] = high.to_be_bytes();
        let [c, d] = low.to_be_bytes();
        Ipv4Addr::new(a, b, c, d)
    };
    match [a, b, c, d, e, f] {
        [0, 0, 0, 0, 0, 0xffff] | [0x64, 0xff9b, 0, 0, 0, 0] => Some(v4(g, h)),
        [0, 0, 0, 0, 0, 0] if g != 0 => Some(v4(g, h)),
        [0x2002, high, low, ..] => Some(v4(high, low)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_machine_and_its_link_are_local_however_they_are_written() {
        for local in [
            "127.0.0.1",
            "127.8.9.1",
            "0.0.0.0",
            "0.1.2.3",
            "169.254.169.254",
            "224.0.0.1",
            "255.255.255.255",
            "::1",
            "::",
            "fe80::1",
            "febf::1",
            "ff02::1",
            "::ffff:127.0.0.1",
            "::ffff:169.254.169.254",
            "::127.0.0.1",
            "64:ff9b::7f00:1",
            "2002:7f00:1::",
        ] {
            assert!(is_local(local.parse().unwrap()), "{local}");
        }
        for other in [
            "10.0.0.1",
            "192.168.1.1",
            "8.8.8.8",
            "2001:db8::1",
            "fd00::1",
            "::ffff:10.0.0.1",
            "64:ff9b::808:808",
        ] {
            assert!(!is_local(other.parse().unwrap()), "{other}");
        }
    }

    #[test]
    fn urls_that_cannot_be_called_are_refused_with_the_reason() {
        for (text, told) in [
            ("farm", "no URL"),
            ("ftp://host/", "http://"),
            ("http://127.0.0.1:80/", "--webhook-allow-local"),
            ("http://2130706433/", "--webhook-allow-local"),
            ("http://[::ffff:127.0.0.1]/", "--webhook-allow-local"),
            ("http://169.254.169.254/latest", "--webhook-allow-local"),
        ] {
            assert!(checked(text, false).unwrap_err().contains(told), "{text}");
        }
        assert!(checked("http://127.0.0.1:80/", true).is_ok());
        assert!(checked("https://hooks.example/a?b", false).is_ok());
    }

    #[tokio::test]
    async fn name_of_this_machine_is_found_out() {
        let url = checked("http://localhost:9/", false).unwrap();
        assert!(resolve(&url, false).await.unwrap_err().contains("this machine"));
        assert!(!resolve(&url, true).await.unwrap().is_empty());
    }
}
