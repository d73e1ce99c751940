# An export of Lightkiln in Godot 4.4. Not run by Lightkiln's tests: written by Godot's documentation.
#
# Attach to a Node3D and set `folder` to an export, e.g. "res://cornell-lit". Meshes get a shader that adds the page's light:
# radiance = base colour / PI * intensity * texel. Transparent materials keep Godot's own.
extends Node3D

@export_dir var folder := "res://cornell-lit"
# Brightness of a radiance of 1 W/m2/sr.
@export var brightness := 1.0

const SHADER := """
shader_type spatial;
render_mode ambient_light_disabled, specular_disabled;
uniform vec4 base_colour : source_color = vec4(1.0);
uniform sampler2D base_texture : source_color, hint_default_white, filter_linear_mipmap, repeat_enable;
uniform sampler2D page : filter_linear, repeat_disable;
uniform float intensity = 1.0;
uniform vec3 emitted = vec3(0.0);
uniform float cutoff = 0.0;

void fragment() {
	vec4 colour = base_colour * texture(base_texture, UV) * COLOR;
	if (colour.a < cutoff) {
		discard;
	}
	ALBEDO = colour.rgb;
	METALLIC = 0.0;
	ROUGHNESS = 1.0;
	EMISSION = emitted + colour.rgb / PI * intensity * texture(page, UV2).rgb;
}
"""

func _ready() -> void:
	var document := GLTFDocument.new()
	var state := GLTFState.new()
	var error := document.append_from_file(folder.path_join("scene.glb"), state)
	if error != OK:
		push_error("%s/scene.glb cannot be read: %s" % [folder, error_string(error)])
		return
	var scene := document.generate_scene(state)
	add_child(scene)
	var lit := _lit_materials(state)
	for node: Node in scene.find_children("*", "MeshInstance3D", true, false):
		var instance := node as MeshInstance3D
		for surface in instance.mesh.get_surface_count():
			var material := instance.mesh.surface_get_material(surface)
			if lit.has(material):
				instance.set_surface_override_material(surface, lit[material])

# Materials that show a page, by those that Godot made of the file's.
func _lit_materials(state: GLTFState) -> Dictionary:
	var lit := {}
	var pages := {}
	var shader := Shader.new()
	shader.code = SHADER
	var made := state.get_materials()
	var written: Array = state.json.get("materials", [])
	for index in mini(made.size(), written.size()):
		var own := made[index] as BaseMaterial3D
		var extras: Dictionary = written[index].get("extras", {})
		if own == null or not extras.has("lightmap") or written[index].get("alphaMode", "OPAQUE") == "BLEND":
			continue
		var file: String = extras["lightmap"]
		if not pages.has(file):
			pages[file] = _page(folder.path_join(file))
		var material := ShaderMaterial.new()
		material.shader = shader
		material.set_shader_parameter("base_colour", own.albedo_color)
		material.set_shader_parameter("base_texture", own.albedo_texture)
		material.set_shader_parameter("page", pages[file])
		material.set_shader_parameter("intensity", float(extras.get("lightmapIntensity", 1.0)) * brightness)
		material.set_shader_parameter("emitted", _radiance(written[index]) * brightness)
		material.set_shader_parameter("cutoff", float(written[index].get("alphaCutoff", 0.0)))
		lit[own] = material
	return lit

# A page: half floats, which Godot's KTX loader reads as they are.
func _page(path: String) -> Texture2D:
	var image := Image.new()
	var error := image.load_ktx_from_buffer(FileAccess.get_file_as_bytes(path))
	if error != OK:
		push_error("%s cannot be read: %s" % [path, error_string(error)])
		return null
	return ImageTexture.create_from_image(image)

# Emission of a material without its texture, in W/m2/sr.
func _radiance(material: Dictionary) -> Vector3:
	var factor: Array = material.get("emissiveFactor", [0.0, 0.0, 0.0])
	var extensions: Dictionary = material.get("extensions", {})
	var strength: float = extensions.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0)
	return Vector3(factor[0], factor[1], factor[2]) * strength
