//! The API's description, made from the handlers and checked in as `server/openapi.json`.

use lightkiln_proto::ids::Digest;
use utoipa::openapi::schema::{KnownFormat, ObjectBuilder, Schema, SchemaFormat, Type};
use utoipa::openapi::security::{Http, HttpAuthScheme, SecurityScheme};
use utoipa::{Modify, OpenApi, PartialSchema, ToSchema, openapi};

use super::{bakes, chunks, enrolments, events, health, leases};

#[derive(OpenApi)]
#[openapi(
    info(
        title = "Lightkiln",
        description = "Relightable global illumination, baked as a service. Errors are RFC 9457 problems.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0")
    ),
    servers((url = "/")),
    tags(
        (name = "scenes", description = "Scene bundles, named by digest"),
        (name = "bakes", description = "Bakes and what happens to them"),
        (name = "chunks", description = "Stored bytes, named by digest"),
        (name = "workers", description = "Who works on the farm"),
        (name = "leases", description = "For workers: tasks, held for a time"),
        (name = "operation", description = "For those who run the server"),
    ),
    paths(
        chunks::put_scene, chunks::head_scene, chunks::put_scene_together, chunks::put_scene_part, chunks::put_chunk, chunks::get_chunk, chunks::head_chunk,
        bakes::submit, bakes::list, bakes::show, bakes::delete, bakes::blocklist, bakes::clear_blocklist, bakes::cancel, bakes::pause, bakes::resume, bakes::reprioritise,
        bakes::manifest, bakes::report, bakes::workers, events::events,
        leases::claim, leases::heartbeat, leases::commit, leases::fail, leases::release,
        enrolments::enrol,
        health::healthz, health::readyz, health::metrics, health::openapi,
    ),
    components(schemas(Digest)),
    modifiers(&Bearer),
    security((), ("bearer" = []))
)]
struct Description;

/// A token in the header Authorization; needed once the farm has one.
struct Bearer;

impl Modify for Bearer {
    fn modify(&self, description: &mut openapi::OpenApi) {
        let scheme = SecurityScheme::Http(Http::new(HttpAuthScheme::Bearer));
        description.components.get_or_insert_default().add_security_scheme("bearer", scheme);
    }
}

/// Plain bytes, as the description has them.
pub(super) enum Binary {}

impl PartialSchema for Binary {
    fn schema() -> openapi::RefOr<Schema> {
        let binary = Some(SchemaFormat::KnownFormat(KnownFormat::Binary));
        ObjectBuilder::new().schema_type(Type::String).format(binary).into()
    }
}

impl ToSchema for Binary {}

/// The OpenAPI description as JSON text.
pub fn openapi_json() -> String {
    // The description is built by macros from valid parts.
    Description::openapi().to_pretty_json().unwrap_or_default() + "\n"
}
