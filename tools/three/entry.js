// What the pages need of three.js, and nothing else of it.
export {
  BufferAttribute, BufferGeometry, DataTexture, DoubleSide, GLSL3, InstancedBufferAttribute, InstancedMesh, Matrix4, Mesh, MultiplyBlending,
  OrthographicCamera, PerspectiveCamera, RawShaderMaterial, Raycaster, Scene, SphereGeometry, Vector3, WebGLRenderer,
} from "three";
