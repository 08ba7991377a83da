//! Certificates. Makes and reads certificates.
//!
//! Keys are ECDSA on P-256. A certificate has its member's name as common name. Only routers and robots, which are dialled, get one that
//! serves an endpoint, and only under the names that it lists: no other member can impersonate a router.

use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose,
};
use time::{Duration, OffsetDateTime};
use x509_parser::extensions::GeneralName;
use x509_parser::pem::parse_x509_pem;
use zenav_protocol::member::Member;

/// Names of every endpoint on its own machine.
const HERE: [&str; 3] = ["localhost", "127.0.0.1", "::1"];
/// Certificates are valid from this long before their issue: clocks of machines differ.
const BEFORE: Duration = Duration::hours(1);

/// A certificate and its private key, as PEM.
pub(super) struct Pair {
    pub(super) certificate: String,
    pub(super) key: String,
}

/// Contents of a certificate.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Facts {
    /// Common name.
    pub(super) name: String,
    /// Serial number, hexadecimal.
    pub(super) serial: String,
    pub(super) expires: OffsetDateTime,
    /// Names and addresses that it may serve.
    pub(super) hosts: Vec<String>,
}

fn valid(days: f64) -> CertificateParams {
    let now = OffsetDateTime::now_utc();
    let mut params = CertificateParams::default();
    params.not_before = now - BEFORE;
    params.not_after = now + Duration::seconds_f64(days * 86400.0);
    params
}

fn named(name: &str) -> DistinguishedName {
    let mut distinguished = DistinguishedName::new();
    distinguished.push(DnType::CommonName, name);
    distinguished
}

/// A certificate authority.
pub(super) fn authority(days: f64) -> Result<Pair, rcgen::Error> {
    let key = KeyPair::generate()?;
    let mut params = valid(days);
    params.distinguished_name = named("zenav fleet");
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    let certificate = params.self_signed(&key)?;
    Ok(Pair {
        certificate: certificate.pem(),
        key: key.serialize_pem(),
    })
}

/// The certificate of a member, reachable under `hosts`, signed by the authority; with a new key, or with the member's existing one.
pub(super) fn member(
    member: &Member,
    hosts: &[String],
    days: f64,
    authority: &Pair,
    key: Option<&str>,
) -> Result<Pair, rcgen::Error> {
    let key = key.map_or_else(KeyPair::generate, KeyPair::from_pem)?;
    let issuer = Issuer::from_ca_cert_pem(&authority.certificate, KeyPair::from_pem(&authority.key)?)?;
    let mut params = valid(days);
    params.distinguished_name = named(&member.to_string());
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
    params.use_authority_key_identifier_extension = true;
    if member.role.listens() {
        params.extended_key_usages.push(ExtendedKeyUsagePurpose::ServerAuth);
        let own = HERE.iter().map(|name| (*name).to_owned());
        let names: Vec<String> = own
            .chain(hosts.iter().filter(|host| !HERE.contains(&host.as_str())).cloned())
            .collect();
        params.subject_alt_names = CertificateParams::new(names)?.subject_alt_names;
    }
    let certificate = params.signed_by(&key, &issuer)?;
    Ok(Pair {
        certificate: certificate.pem(),
        key: key.serialize_pem(),
    })
}

/// Reads the contents of a certificate.
///
/// # Errors
/// What was expected.
pub(super) fn facts(text: &[u8]) -> Result<Facts, String> {
    let (_, pem) = parse_x509_pem(text).map_err(|_| "expected a certificate in PEM".to_owned())?;
    let parsed = pem
        .parse_x509()
        .map_err(|_| "expected an X.509 certificate".to_owned())?;
    let name = parsed
        .subject()
        .iter_common_name()
        .next()
        .and_then(|name| name.as_str().ok());
    let alternatives = parsed.subject_alternative_name().ok().flatten();
    let hosts = alternatives.iter().flat_map(|names| &names.value.general_names);
    Ok(Facts {
        name: name.ok_or("expected a common name")?.to_owned(),
        serial: parsed
            .tbs_certificate
            .raw_serial()
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect(),
        expires: parsed.validity().not_after.to_datetime(),
        hosts: hosts.filter_map(host).collect(),
    })
}

fn host(name: &GeneralName<'_>) -> Option<String> {
    match name {
        GeneralName::DNSName(name) => Some((*name).to_owned()),
        GeneralName::IPAddress(bytes) => {
            let v4 = <[u8; 4]>::try_from(*bytes).map(|bytes| std::net::IpAddr::from(bytes).to_string());
            let v6 = <[u8; 16]>::try_from(*bytes).map(|bytes| std::net::IpAddr::from(bytes).to_string());
            v4.or(v6).ok()
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_certificate_says_who_it_is_of_and_where_it_is_reached() {
        let authority = authority(10.0).unwrap();
        let hosts = ["site1.local".to_owned(), "10.0.0.2".to_owned()];
        let router = member(&"router.site1".parse().unwrap(), &hosts, 1.0, &authority, None).unwrap();
        let said = facts(router.certificate.as_bytes()).unwrap();
        assert_eq!(said.name, "router.site1");
        assert_eq!(said.hosts, ["localhost", "127.0.0.1", "::1", "site1.local", "10.0.0.2"]);
        let left = said.expires - OffsetDateTime::now_utc();
        assert!(left > Duration::hours(23) && left <= Duration::days(1), "{left}");
        // Renewed: another certificate for the same key.
        let renewed = member(
            &"router.site1".parse().unwrap(),
            &hosts,
            2.0,
            &authority,
            Some(&router.key),
        )
        .unwrap();
        assert_eq!(renewed.key, router.key);
        assert!(facts(renewed.certificate.as_bytes()).unwrap().expires > said.expires);
    }

    #[test]
    fn who_is_not_dialled_serves_no_endpoint() {
        let authority = authority(10.0).unwrap();
        let viewer = member(
            &"viewer.wall".parse().unwrap(),
            &["site1.local".to_owned()],
            1.0,
            &authority,
            None,
        )
        .unwrap();
        let said = facts(viewer.certificate.as_bytes()).unwrap();
        assert!(said.hosts.is_empty(), "{said:?}");
        let (_, pem) = parse_x509_pem(viewer.certificate.as_bytes()).unwrap();
        let parsed = pem.parse_x509().unwrap();
        let usage = parsed.extended_key_usage().unwrap().unwrap().value;
        assert!(usage.client_auth && !usage.server_auth);
    }
}
