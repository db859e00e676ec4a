# Build for ROS 2, with ament_cmake. CMakeLists.txt includes this file if ROS_VERSION is 2.
cmake_minimum_required(VERSION 3.18)

if(NOT CMAKE_CXX_STANDARD)
  set(CMAKE_CXX_STANDARD 17)
endif()

find_package(ament_cmake REQUIRED)
find_package(ament_cmake_python REQUIRED)
find_package(builtin_interfaces REQUIRED)
find_package(rosidl_default_generators REQUIRED)

# The interface files are written for ROS 1, whose basic types include `time` and `duration`. ROS 2 has messages instead.
set(interface_folder ${CMAKE_CURRENT_BINARY_DIR}/interfaces)
file(
  GLOB interface_files RELATIVE ${CMAKE_CURRENT_SOURCE_DIR} CONFIGURE_DEPENDS
  ${CMAKE_CURRENT_SOURCE_DIR}/msg/*.msg ${CMAKE_CURRENT_SOURCE_DIR}/srv/*.srv
)
set(interfaces)
foreach(file ${interface_files})
  file(READ ${file} definition)
  string(REGEX REPLACE "(^|\n)time([ [])" "\\1builtin_interfaces/Time\\2" definition "${definition}")
  string(REGEX REPLACE "(^|\n)duration([ [])" "\\1builtin_interfaces/Duration\\2" definition "${definition}")
  # A file that has not changed keeps its timestamp, so that nothing is generated again.
  file(CONFIGURE OUTPUT ${interface_folder}/${file} CONTENT "${definition}" @ONLY)
  set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${file})
  list(APPEND interfaces ${interface_folder}:${file})
endforeach()
rosidl_generate_interfaces(${PROJECT_NAME} ${interfaces} DEPENDENCIES builtin_interfaces)

# The Python package and the generated one have the same name and are merged: the generated package has the subpackages
# `msg` and `srv`, and an empty `__init__.py`. This rule follows that of the generated package, so its `__init__.py` wins.
install(
  DIRECTORY src/${PROJECT_NAME}/
  DESTINATION ${PYTHON_INSTALL_DIR}/${PROJECT_NAME}
  PATTERN "__pycache__" EXCLUDE
)

# In the folder for `ros2 run`, and in the one that setup.bash puts on PATH.
foreach(destination lib/${PROJECT_NAME} bin)
  install(PROGRAMS nodes/${PROJECT_NAME} DESTINATION ${destination})
endforeach()
# In the sources it has another name: rosrun of ROS 1 searches them, and needs a single program of a name.
install(
  PROGRAMS nodes/ros2/${PROJECT_NAME}_ros2_node
  DESTINATION lib/${PROJECT_NAME}
  RENAME ${PROJECT_NAME}_node
)

install(
  DIRECTORY application_source examples
  DESTINATION share/${PROJECT_NAME}
  PATTERN "__pycache__" EXCLUDE
)
install(
  DIRECTORY launch
  DESTINATION share/${PROJECT_NAME}
  FILES_MATCHING PATTERN "*.launch.py"
)
# The documentation site, if ./install.py docs has built it.
file(GLOB site ${CMAKE_CURRENT_SOURCE_DIR}/docs/_build/html)
if(site)
  install(DIRECTORY ${site} DESTINATION share/${PROJECT_NAME}/docs)
endif()
# The pages that the commands `help` and `console` search.
install(
  DIRECTORY docs/explanation docs/how-to docs/reference docs/tutorials
  DESTINATION share/${PROJECT_NAME}/docs
  FILES_MATCHING PATTERN "*.md"
)

# Completion of the command `retalis` in shells that source the setup file.
set(hooks ${CMAKE_CURRENT_BINARY_DIR}/hooks)
configure_file(src/${PROJECT_NAME}/cli/${PROJECT_NAME}.bash ${hooks}/${PROJECT_NAME}.bash COPYONLY)
configure_file(src/${PROJECT_NAME}/cli/_${PROJECT_NAME} ${hooks}/${PROJECT_NAME}.zsh COPYONLY)
ament_environment_hooks(${hooks}/${PROJECT_NAME}.bash ${hooks}/${PROJECT_NAME}.zsh)

ament_export_dependencies(rosidl_default_runtime)
# Packages that depend on this one test their programs by ament_add_retalis_test.
ament_package(CONFIG_EXTRAS ${CMAKE_CURRENT_SOURCE_DIR}/cmake/${PROJECT_NAME}-extras-ros2.cmake)
